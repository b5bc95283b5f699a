"""Files of the RGL material database, which Mitsuba's `measured` BSDF loads (Dupuy and Jakob 2018)."""

from __future__ import annotations

from data_tools.formats import Format
from data_tools.formats.merl import SAMPLES

HELP = """Convert RGL measurements, isotropic BRDFs.

A file of the RGL material database (Dupuy and Jakob 2018) that ends in _rgb.bsdf. Mitsuba evaluates it; it becomes
samples (angles in rad, reflectance in 1/sr, linear RGB) above the horizon. Anisotropic and spectral files are refused.
A bad file that was named ends the conversion and nothing is written; one found in a folder is skipped with a warning.

Examples:
  metapp data bsdf chm_orange_rgb.bsdf --out rgl
  metapp data bsdf measurements --split test --out rgl
"""

FORMAT = Format(
    "bsdf",
    "brdf",
    "data_tools.readers.rgl",
    "RGL .bsdf files",
    exports=True,
    noun="RGL file",
    help=HELP,
    paths=("FILES...", ".bsdf files, and folders searched at any depth."),
    settings=(SAMPLES,),
)
