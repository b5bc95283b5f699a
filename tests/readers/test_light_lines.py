"""Lines of texts of light directions: as programs, spreadsheets and people write them; others are refused."""

import re
from pathlib import Path

import pytest

from data_tools.readers.light_lines import LightLine, read_light_lines

EXPECTED = [("IMG 1.jpg", (0.61, -0.1, 0.79)), ("IMG 2.jpg", (-0.35, 0.0, 0.9))]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize(
    "text",
    [
        "2\nIMG 1.jpg 0.61 -0.10 0.79\nIMG 2.jpg -0.35 0 0.9\n",
        "\n2  \t\r\n\r\nIMG 1.jpg\t.61\t-1e-1\t+0.79\t\r\nIMG 2.jpg   -0.35  0.  0.9  \r\n",
        "IMG 1.jpg 0,61 -0,10 0,79\nIMG 2.jpg -0,35 0 0,9",
        "2;;;\nIMG 1.jpg;0,61;-0,10;0,79;\nIMG 2.jpg; -0,35; 0; 0,9\n",
        "2\nIMG 1.jpg\t0,61\t-0,10\t0,79\nIMG 2.jpg\t-0,35\t0\t0,9\n",
        '2,,,\nIMG 1.jpg,0.61,-0.10,0.79\n"IMG 2.jpg", -0.35, 0, 0.9\n',
        "# lamps\n2 # photos\n// of a coin\n'IMG 1.jpg' 0.61 -0.1 0.79 # low\nD:\\dome 3\\IMG 2.jpg -0.35 0 0.9 ; 7\n",
        "2 photos\nname;lx;ly;lz\nphotos/IMG 1.jpg;0.61;-0.1;0.79\n/home/me/IMG 2.jpg;-0.35;0;0.9\n",
    ],
)
def test_texts_of_many_programs_say_the_same(tmp_path: Path, text: str, encoding: str) -> None:
    path = tmp_path / "coin.lp"
    path.write_bytes(text.encode(encoding))
    lines, notes = read_light_lines(path)
    assert [(line.name, line.direction) for line in lines] == EXPECTED
    assert not notes


def test_lines_of_numbers_alone_have_no_name_or_a_number_as_name(tmp_path: Path) -> None:
    path = tmp_path / "coin.lp"
    path.write_text("0.6 0 0.8\n7 0 0 2\ncoin 01 0 1 1\n")
    assert read_light_lines(path)[0] == [
        LightLine(1, "", (0.6, 0, 0.8)), LightLine(2, "7", (0, 0, 2)), LightLine(3, "coin 01", (0, 1, 1)),
    ]  # fmt: skip


@pytest.mark.parametrize(("before", "behind", "numbers"), [("", " 400", "1 to 3"), (" 12 7", "", "3 to 5")])
def test_the_columns_that_are_unit_vectors_are_taken_and_said(
    tmp_path: Path, before: str, behind: str, numbers: str
) -> None:
    path = tmp_path / "coin.lp"
    path.write_text(f"2\na.jpg{before} 0.6 0 0.8{behind}\nb.jpg{before} 0 0 1{behind}\n")
    lines, (note,) = read_light_lines(path)
    assert [line.direction for line in lines] == [(0.6, 0, 0.8), (0, 0, 1)]
    assert f"numbers {numbers}" in note


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("a.jpg 1 2 3 4\n", "4 numbers behind names, of which 0 triples"),
        ("a.jpg 1 0 0 0 1\n", "5 numbers behind names, of which 2 triples"),
        ("a.jpg 0,61,0,10,0,79\n", "6 numbers behind names"),
        ("a.jpg 0 0 1\nb.jpg 0 0 1 5\nc.jpg 0 0 1\n", "other than 3 numbers behind the name in 1 of 3 lines: 2"),
        ("a.jpg 0 0 0\n", "line 1 is 'a.jpg 0 0 0'"),
        ("2\na.jpg 0 0 nan\nb.jpg 0 0 1", "line 2 is 'a.jpg 0 0 nan'"),
        ("2\na.jpg 0 0 1e999\nb.jpg 0 0 1", "line 2 is 'a.jpg 0 0 1e999'"),
        ("coin of silver\na.jpg 0 0 1", "line 1 is 'coin of silver' above 1 lines"),
        ("# nothing\n", "no line"),
    ],
)
def test_lines_that_do_not_tell_a_direction_are_refused(tmp_path: Path, text: str, fault: str) -> None:
    path = tmp_path / "coin.lp"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"^{re.escape(f'{path}: {fault}')}.*expected"):
        read_light_lines(path)
