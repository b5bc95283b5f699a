"""Files of the RGL material database, which Mitsuba's `measured` BSDF loads (Dupuy and Jakob 2018)."""

from __future__ import annotations

import functools
from pathlib import Path

from data_tools.formats import Conversion, FilesAndWriter, Format, Reader
from data_tools.formats.merl import SAMPLES

HELP = """Convert RGL measurements, isotropic BRDFs.

A file of the RGL material database (Dupuy and Jakob 2018) that ends in _rgb.bsdf. Mitsuba evaluates it; it becomes
samples (angles in rad, reflectance in 1/sr, linear RGB) above the horizon. Anisotropic and spectral files are refused.
A bad file that was named ends the conversion and nothing is written; one found in a folder is skipped with a warning.

Examples:
  metapp data bsdf chm_orange_rgb.bsdf --out rgl
  metapp data bsdf measurements --split test --out rgl
"""


def _files() -> FilesAndWriter:
    from data_tools.readers import rgl

    return rgl


def _reader(paths: list[Path], split: str, *, samples: int) -> Reader:
    from data_tools.readers import brdf_task, rgl

    read = functools.partial(rgl.read_task, samples=samples)
    notes = {"made_by": "metapp data bsdf", "samples": samples}
    return Reader("brdf", "RGL file", brdf_task.UNITS, rgl.find, lambda source: source.stem, read, notes)


FORMAT = Format(
    "bsdf",
    "brdf",
    "RGL .bsdf files",
    _files,
    _files,
    Conversion(HELP, _reader, ("FILES...", ".bsdf files, and folders searched at any depth."), (SAMPLES,)),
)
