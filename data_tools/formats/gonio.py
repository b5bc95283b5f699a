"""Gonioreflectometer measurements as CSV."""

from __future__ import annotations

from pathlib import Path

from data_tools.formats import Conversion, Files, Format, Reader

HELP = """Convert goniometer measurements, CSV files.

A line of column names, then a row for each pair of directions: theta_i_deg, phi_i_deg (light), theta_o_deg, phi_o_deg
(detector), or _rad for radians, and the BRDF in 1/sr as r, g, b (linear RGB) or as wavelengths (400nm, 410nm, ...).
Lines that begin with # are comments. The measurements themselves are the samples, in random order; a bad file that
was named ends the conversion and nothing is written; one found in a folder is skipped with a warning.

Examples:
  metapp data gonio paint.csv --out measured
  metapp data gonio measurements --split test --out measured
"""


def _files() -> Files:
    from data_tools.readers import gonio

    return gonio


def _reader(paths: list[Path], split: str) -> Reader:
    from data_tools.readers import brdf_task, gonio

    units = {key: unit for key, unit in brdf_task.UNITS.items() if key != "environment"}
    notes = {"made_by": "metapp data gonio"}
    return Reader("brdf", "CSV file", units, gonio.find, lambda source: source.stem, gonio.read_task, notes)


FORMAT = Format(
    "gonio",
    "brdf",
    "goniometer .csv files",
    _files,
    conversion=Conversion(HELP, _reader, ("FILES...", ".csv files, and folders searched at any depth.")),
)
