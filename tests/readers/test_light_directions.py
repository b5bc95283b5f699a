"""Photographs by a camera that stands still, with an RTI text of light directions: one input, and clear refusals."""

import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from data_tools.readers import rti_photos
from data_tools.readers.light_directions import read_lights
from metapp.appearance.colour import srgb_to_linear
from tests.cli.messages import says
from tests.pictures import noise_image, write_image

COUNT = 4


def lights(names: list[str]) -> str:
    rows = [(math.cos(turn), math.sin(turn), 1.0) for turn in np.linspace(0, 5, len(names))]
    return f"{len(names)}\n" + "".join(f"{name} {x} {y} {z}\n" for name, (x, y, z) in zip(names, rows, strict=True))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Four photographs, 64 x 48, of which the text has another order than that of their names."""
    result = tmp_path / "coin"
    for number in range(COUNT):
        write_image(result / f"{number} b.png", noise_image(48, 64, seed=number))
    (result / "coin.lp").write_text(lights([f"C:\\photos\\{number} b.png" for number in (3, 1, 0, 2)]))
    return result


def test_a_folder_is_one_task_in_the_order_of_the_text(folder: Path) -> None:
    for path in (folder, folder / "coin.lp", folder.parent):
        (source,), skipped = rti_photos.find(path)
        assert rti_photos.recognises(path)
        assert (source.name, source.path.resolve(), skipped) == ("coin", folder.resolve(), [])
    paths, directions, notes = read_lights(folder / "coin.lp")
    assert ([path.name for path in paths], notes) == (["3 b.png", "1 b.png", "0 b.png", "2 b.png"], [])
    task = rti_photos.read_task(folder)
    assert task.data["lit"].shape == (COUNT, 3, 48, 64)
    torch.testing.assert_close(task.data["lamps"], directions)
    mean = srgb_to_linear(task.data["lit"].float() / 255).mean(0)
    torch.testing.assert_close(srgb_to_linear(task.data["photo"].float() / 255), mean, atol=0.01, rtol=0)
    torch.testing.assert_close(directions[0], torch.tensor([1.0, 0.0, 1.0]) / math.sqrt(2))


@pytest.mark.parametrize(
    ("change", "facts"),
    [
        (lambda text: text.replace("4\n", "5\n", 1), ("line 1", "'5'", "4 lines", "expected the number of photos")),
        (lambda text: "", ("no line", "expected the number of photos")),
        (lambda text: text.replace("3 b.png 1.0", "3 b.png x"), ("line 2", "expected a name and a direction x y z")),
        (
            lambda text: text.replace("3 b", "9 b").replace("1 b", "8 b"),
            ("2 of 4", "line 2", "'9 b.png'", "line 3", "'8 b.png'", "no such file", "expected the photos"),
        ),
        (lambda text: text.replace(" 1.0\n", " -1.0\n", 2), ("2 of 4 lamps", "line 2", "line 3", "3 or more above it")),
        (lambda text: text + "\0", ("expected the number of photos, then 'name x y z' for each",)),
        (lambda text: "0\n", ("line 1", "'0'", "0 lines", "expected the number of photos")),
        (lambda text: f"\n{text.replace('4', '²', 1)}", ("line 2", "'²'", "4 lines", "expected the number of photos")),
        (lambda text: text.replace("4", "4" * 5000, 1), ("line 1", "'44444", "4 lines", "expected the number")),
        (lambda text: text.replace("4", "-4", 1), ("line 1", "'-4'", "4 lines", "expected the number of photos")),
    ],
)
def test_texts_that_are_none_are_refused_in_one_line(
    metapp: Callable, folder: Path, change: Callable[[str], str], facts: tuple[str, ...]
) -> None:
    path = folder / "coin.lp"
    path.write_text(change(path.read_text()))
    with pytest.raises(ValueError, match="expected") as caught:
        read_lights(path)
    assert says(str(caught.value), str(path), *facts)
    assert says(metapp("general", "svbrdf_nonstationary", folder).error, "coin.lp", *facts)


def test_the_count_may_have_leading_zeros(folder: Path) -> None:
    path = folder / "coin.lp"
    path.write_text("00" + path.read_text())
    assert len(read_lights(path)[0]) == COUNT


@pytest.mark.parametrize("name", ["coin.lp", "camera_pos.txt"])
@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo], ids=["folder", "pipe"])
def test_a_text_that_is_a_folder_or_a_pipe_is_not_ignored(
    metapp: Callable, folder: Path, name: str, make: Callable[[Path], None]
) -> None:
    (folder / "coin.lp").unlink()
    (folder / "image_size.txt").write_text("10")
    make(folder / name)
    for path in (folder, folder.parent):
        assert says(metapp("general", "svbrdf_nonstationary", path).error, name, "expected")


def test_photographs_of_several_sizes_and_texts_are_refused(metapp: Callable, folder: Path) -> None:
    write_image(folder / "0 b.png", noise_image(48, 48))
    assert (
        "expected 64 x 48 as in 3 b.png, by a camera that stands still"
        in metapp("general", "svbrdf_nonstationary", folder).error
    )
    (folder / "other.lp").write_text("0\n")
    assert "expected one text of light directions" in metapp("general", "svbrdf_nonstationary", folder).error


def names_and_notes(path: Path) -> tuple[list[str], str]:
    photos, _, notes = read_lights(path)
    return [photo.name for photo in photos], "\n".join(notes)


def test_names_in_other_capitals_and_with_other_endings_are_found_and_said(folder: Path) -> None:
    path, order = folder / "coin.lp", ["3 b.png", "1 b.png", "0 b.png", "2 b.png"]
    path.write_text(path.read_text().replace("3 b.png", "3 B.PNG").replace("1 b.png", "1 b.dng"))
    (folder / "1 b.dng").touch()  # a raw beside its picture
    names, notes = names_and_notes(path)
    assert names == order
    assert says(notes, "coin.lp", "2 of 4 photos have other names", "'3 b.png' for line 2 ('3 B.PNG')")
    with pytest.warns(UserWarning, match="2 of 4 photos have other names"):
        rti_photos.read_task(folder)
    write_image(folder / "1 b.tif", noise_image(48, 64))  # now two files have this stem
    (folder / "1 b.dng").unlink()
    names, notes = names_and_notes(path)
    assert names == [order[0], *order[2:]]
    assert says(notes, "1 of 4 photos are missing", "line 3 ('1 b.dng')")


def test_missing_and_unnamed_photos_are_said_and_left_out(folder: Path) -> None:
    path = folder / "coin.lp"
    path.write_text(path.read_text().replace("4\n", "9\n", 1) + "".join(f"gone{n}.png 0 0 1\n" for n in range(5)))
    for name in ("thumb.jpg", "ball.jpg"):
        write_image(folder / name, noise_image(48, 64))
    names, notes = names_and_notes(path)
    assert len(names) == COUNT
    assert says(notes, "5 of 9 photos are missing", "line 6 ('gone0.png')", "line 8", "and 2 more", "the other 4")
    assert says(notes, "does not name: 2", "'ball.jpg', 'thumb.jpg'", "left out")


def test_names_that_fit_no_file_are_taken_in_natural_order(tmp_path: Path) -> None:
    for number in range(1, 12):
        write_image(tmp_path / f"IMG_{number}.png", noise_image(4, 4))
    stated = [f"old{number}.tif" for number in range(1, 12)]
    expected = [f"IMG_{number}.png" for number in range(1, 12)]
    for names, order in ((stated, expected), (sorted(stated), sorted(expected)), ([""] * 11, expected)):
        (tmp_path / "coin.lp").write_text(lights(names))
        photos, notes = names_and_notes(tmp_path / "coin.lp")
        assert photos == order
        assert says(notes, "none of its 11 names", "in their order", "'IMG_1.png' for line 2", "'IMG_11.png'")
    (tmp_path / "IMG_12.png").write_bytes((tmp_path / "IMG_1.png").read_bytes())
    with pytest.raises(ValueError, match="photos beside it: 12, expected the photos that it names"):
        read_lights(tmp_path / "coin.lp")


def test_directions_from_the_lamp_are_turned_round_and_lamps_below_left_out(folder: Path) -> None:
    path = folder / "coin.lp"
    text, (before, directions, _) = path.read_text(), read_lights(path)
    rows = [line.rsplit(" ", 3) for line in text.splitlines()[1:]]
    opposite = "".join(f"{name} {-float(x)} {-float(y)} {-float(z)}\n" for name, x, y, z in rows)
    path.write_text(f"4\n{opposite}")
    photos, turned, notes = read_lights(path)
    assert photos == before
    torch.testing.assert_close(turned, directions)
    assert says("\n".join(notes), "4 of 4 directions", "from the lamp", "taken: the opposite directions")
    path.write_text(text.replace(" 1.0\n", " -1.0\n", 1))
    photos, left, notes = read_lights(path)
    assert photos == before[1:]
    assert torch.equal(left, directions[1:])
    assert says("\n".join(notes), "1 of 4 lamps are not above", "line 2 ('3 b.png')", "left out")
