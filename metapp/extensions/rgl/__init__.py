"""BRDFs as Mitsuba 3 has them: files of the RGL material database, and scenes that show fits."""

from __future__ import annotations

from data_tools.formats.brdf import SampleOptions
from metapp.door import Converter, Export, FileExport, Format

_HERE = "metapp.extensions.rgl"

RGL = """Convert RGL measurements, BRDFs, isotropic or anisotropic.

A file of the RGL material database (Dupuy and Jakob 2018), _rgb.bsdf or _spec.bsdf. Mitsuba evaluates it; it becomes
samples (angles in rad, reflectance in 1/sr, linear RGB, spectra in D65) above the horizon.
A bad file that was named ends the conversion and nothing is written; one found in a folder is skipped with a warning.

Examples:
  metapp data bsdf chm_orange_rgb.bsdf --out rgl
  metapp data bsdf measurements --split test --out rgl
"""

OFFERS = (
    Format(
        "bsdf",
        "brdf",
        f"{_HERE}.rgl",
        "RGL .bsdf files",
        command=Converter(
            RGL, "RGL file", "FILES...", ".bsdf files, and folders searched at any depth.", SampleOptions
        ),
    ),
    Export("bsdf", ("brdf",), f"{_HERE}.rgl:export"),
    Export("bsdf-spectral", ("brdf",), f"{_HERE}.rgl:export_spectral"),
    Export("mitsuba", ("brdf",), f"{_HERE}.scene:export"),
    FileExport(
        ("merl", "bsdf", "bsdf-spectral"),
        "MERL tables, RGL files, NBRDF networks, folders of them",
        f"{_HERE}.convert:write",
    ),
)
