"""Inputs of a run, and where records say that they are."""

from __future__ import annotations

from pathlib import Path

from data_tools.synthetic.examples import write_example
from metapp.runs.inputs.sources import sources_to_fit
from metapp.runs.options import fit_options
from metapp.runs.run import Run


def test_records_name_inputs_as_they_were_given(tmp_path: Path) -> None:
    """A link that is given is what pages and exports read again, wherever it leads then."""
    first, link = tmp_path / "first.csv", tmp_path / "newest.csv"
    first.write_text("")
    link.symlink_to(first)
    planned = Run.of(fit_options("brdf", "general", inputs=[link], out=tmp_path, quiet=True))
    (source,) = sources_to_fit(planned)[0]
    assert planned.origin(source.given) == {"inputs": [str(link)]}
    assert source.place == str(first)


def test_files_are_read_as_fine_as_fits_are(tmp_path: Path) -> None:
    for app, side in (("illumination", 128), ("texture", 256)):
        planned = Run.of(fit_options(app, "general", inputs=write_example(app, tmp_path)[:1], recipe="full"))
        (source,) = sources_to_fit(planned)[0]
        assert planned.app.read_size in (0, side)
        assert side in source.task().data["map" if app == "illumination" else "image"].shape
