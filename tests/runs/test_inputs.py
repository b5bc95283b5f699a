"""Thousands of inputs take a time that grows as their number, not as its square."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from data_tools.readers.nbrdf import SHAPES, read_nbrdf
from metapp.learning.task import Task
from metapp.runs.inputs.sources import Source, marks_of, numbered, sources_to_fit
from metapp.runs.options import fit_options
from metapp.runs.plan import plan


def test_a_folder_of_many_networks_is_listed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in "abcdefgh":
        for part, shape in SHAPES.items():
            np.save(tmp_path / f"{name}_{part}.npy", np.zeros(shape, np.float32))
    listed, original = [], Path.iterdir

    def iterdir(self: Path) -> Iterator[Path]:
        listed.append(self)
        return original(self)

    monkeypatch.setattr(Path, "iterdir", iterdir)
    sources, _ = sources_to_fit(plan(fit_options("brdf", inputs=[tmp_path])))
    for source in sources:
        assert read_nbrdf(source.place)["fc1"].shape == (6, 21)
    assert len(sources) == 8
    assert listed == [tmp_path]


def test_thousands_of_inputs_of_one_name_are_numbered_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("metapp.runs.inputs.sources.say", lambda line: None)
    begin, taken = time.process_time(), {}
    names = [numbered(name, f"{i}", taken) for i, name in enumerate(["a-3", *["a"] * 3000])]
    assert time.process_time() - begin < 5
    assert names[:5] == ["a-3", "a", "a-2", "a-4", "a-5"]
    assert len(set(names)) == 3001


@pytest.mark.parametrize(
    ("places", "marks"),
    [
        ("/x/a.xml /x/b.xml", ["", ""]),
        ("/x/kitchen/scene.xml /x/bath/scene.xml", ["kitchen", "bath"]),
        ("/x/wood/color.png /y/wood/color.png", ["x", "y"]),
        ("/x/scene.xml /x/old/scene.xml", ["x", "old"]),
        ("/a/scene.xml /b/scene.xml /c/a/scene.xml", ["a", "b", "c-a"]),
        ("/x/wood.jpg /x/wood.png /x/other.png", ["jpg", "png", ""]),
    ],
)
def test_files_of_one_stem_are_told_apart_by_their_folders(places: str, marks: list[str]) -> None:
    assert list(marks_of({place: Path(place).stem for place in places.split()}).values()) == marks


@pytest.mark.parametrize(
    ("name", "named"),
    [("scene", "kitchen-scene"), ("kitchen", "kitchen"), ("kitchen_1", "kitchen_1"), ("kitchens", "kitchen-kitchens")],
)
def test_a_task_that_its_reader_named_by_the_folder_is_not_marked_again(name: str, named: str) -> None:
    assert Source("/x", lambda: Task(name, {}), mark="kitchen").task().name == named


def test_records_name_inputs_as_they_were_given(tmp_path: Path) -> None:
    """A link that is given is what pages and exports read again, wherever it leads then."""
    first, link = tmp_path / "first.csv", tmp_path / "newest.csv"
    first.write_text("")
    link.symlink_to(first)
    origin = plan(fit_options("brdf", "general", inputs=[link], out=tmp_path, quiet=True)).origin()
    assert origin["inputs"] == [str(link)]
