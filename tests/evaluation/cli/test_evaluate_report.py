"""The figures and the report of `metapp evaluate`: tables as Markdown, which links to the figures."""

import itertools
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from metapp.evaluation.figures import FIGURE_FUNCTIONS
from metapp.evaluation.style import place_labels
from metapp.registry import registry


def headings(text: str) -> list[str]:
    return re.findall(r"^## (.*)$", text, re.MULTILINE)


@pytest.mark.long
def test_the_report_has_all_tables_and_links_to_all_figures(
    evaluate: Callable, evaluated_folder: Path, tmp_path: Path
) -> None:
    words = ("--out", evaluated_folder / "runs", "--no-run", "--quiet", "--json")
    assert evaluate(*words, "--report", tmp_path / "report", "--figures", tmp_path / "figures").code == 0
    figures = {f"brdf-{name}.{form}" for name in FIGURE_FUNCTIONS for form in ("png", "pdf")}
    assert {file.name for file in (tmp_path / "figures").iterdir()} == figures
    assert {file.name for file in (tmp_path / "report").iterdir()} == figures | {"index.md"}
    assert (tmp_path / "figures" / "brdf-plane.pdf").read_bytes().startswith(b"%PDF")
    text = (tmp_path / "report" / "index.md").read_text()
    assert set(re.findall(r"^!\[.+\]\((.*)\)$", text, re.MULTILINE)) == {
        f"brdf-{name}.png" for name in FIGURE_FUNCTIONS
    }
    assert len(headings(text)) == len(registry().tables) + len(FIGURE_FUNCTIONS)
    assert {"Error and time", "Storage"} < set(headings(text))
    for expected in ("| app | paradigm |", "| brdf | meta |", "- vs quickft: ", "95 % interval"):
        assert expected in text
    assert "Not measured yet." not in text


def test_a_report_has_and_runs_the_table_that_is_asked_for(evaluate: Callable, tmp_path: Path) -> None:
    """Without any run, a report has rows without figures."""
    assert evaluate("--no-run", "--which", "quickft", "--report", tmp_path / "none", "--quiet").code == 0
    text = (tmp_path / "none" / "index.md").read_text()
    assert "| brdf | meta | - | - | - |" in text
    assert "brdf-curves" not in text
    assert evaluate("--which", "quickft", "--report", tmp_path / "report", "--quiet", "--json").code == 0
    text = (tmp_path / "report" / "index.md").read_text()
    assert headings(text)[0] == "Against as many steps of fine-tuning"
    assert not {"Methods without a network", "Error and time"} & set(headings(text))
    folders = {folder.name.split("-")[0] for folder in (tmp_path / "runs" / "brdf").iterdir()}
    assert folders == {"general", "meta", "quickft"}


def test_names_of_crowded_places_do_not_overlap() -> None:
    axis = Figure().subplots()
    places = [(0.5 + 0.02 * (i % 3), 0.5 + 0.02 * (i // 3)) for i in range(9)]
    axis.plot(*zip(*places, strict=True), "o")
    axis.set(xlim=(0, 1), ylim=(0, 1))
    place_labels(axis, [(f"name {i}", place, {"fontsize": 7}) for i, place in enumerate(places)])
    boxes = [Text.get_window_extent(note) for note in axis.texts]
    assert len(boxes) == 9
    assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))
    assert all(axis.bbox.x0 <= box.x0 and box.x1 <= axis.bbox.x1 for box in boxes)
