"""Inputs of a run, and where records say that they are."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from data_tools.readers.nbrdf import SHAPES, read_nbrdf
from metapp.runs.inputs.sources import sources_to_fit
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


def test_records_name_inputs_as_they_were_given(tmp_path: Path) -> None:
    """A link that is given is what pages and exports read again, wherever it leads then."""
    first, link = tmp_path / "first.csv", tmp_path / "newest.csv"
    first.write_text("")
    link.symlink_to(first)
    planned = plan(fit_options("brdf", "general", inputs=[link], out=tmp_path, quiet=True))
    (source,) = sources_to_fit(planned)[0]
    assert planned.origin(source.given) == {"inputs": [str(link)]}
    assert source.place == str(first)
