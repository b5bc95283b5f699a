"""MERL tables (Matusik et al. 2003)."""

from __future__ import annotations

import functools
from pathlib import Path

from data_tools.formats import Conversion, FilesAndWriter, Format, Reader, Setting

HELP = """Convert MERL tables, measured BRDFs.

A table (Matusik et al. 2003) has 34,992,012 bytes. It becomes samples (angles in rad, reflectance in 1/sr, linear
RGB) at the centres of measured bins. A bad file that was named ends the conversion and nothing is written; one
found in a folder is skipped with a warning.

Examples:
  metapp data merl BRDFDatabase/brdfs --out merl
  metapp data merl gold.binary steel.binary --split test --out metals
"""
SAMPLES = Setting(
    "samples", 65_536, "Samples (pairs of directions) per material; the first half is for fits to see.", "N", low=2
)


def _files() -> FilesAndWriter:
    from data_tools.readers import merl

    return merl


def _reader(paths: list[Path], split: str, *, samples: int) -> Reader:
    from data_tools.readers import brdf_task, merl

    read = functools.partial(merl.read_task, samples=samples)
    notes = {"made_by": "metapp data merl", "samples": samples}
    return Reader("brdf", "MERL file", brdf_task.UNITS, merl.find_merl, lambda source: source.stem, read, notes)


FORMAT = Format(
    "merl",
    "brdf",
    "MERL .binary files",
    _files,
    _files,
    Conversion(HELP, _reader, ("FILES...", ".binary files, and folders searched at any depth."), (SAMPLES,)),
)
