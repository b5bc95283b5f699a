"""BRDFs as Mitsuba 3 has them: files of the RGL material database, and scenes that show fits."""

from __future__ import annotations

from data_tools.formats.brdf import SampleOptions
from metapp.registry import Entry, Export, Format, Registry

_HERE = "metapp.extensions.rgl"

RGL = """Convert RGL measurements, BRDFs, isotropic or anisotropic.

A file of the RGL material database (Dupuy and Jakob 2018), _rgb.bsdf or _spec.bsdf. Mitsuba evaluates it; it becomes
samples (angles in rad, reflectance in 1/sr, linear RGB, spectra in D65) above the horizon.
A bad file that was named ends the conversion and nothing is written; one found in a folder is skipped with a warning.

Examples:
  metapp data bsdf chm_orange_rgb.bsdf --out rgl
  metapp data bsdf measurements --split test --out rgl
"""


def register(registry: Registry) -> None:
    """Add the files and the scenes."""
    registry.formats["bsdf"] = Format(
        f"{_HERE}.rgl",
        app="brdf",
        inputs="RGL .bsdf files",
        kinds=(("phi_h", "is_anisotropic"),),
        help=RGL,
        options=SampleOptions,
    )
    registry.exports["brdf", "bsdf"] = Export(f"{_HERE}.rgl:export")
    registry.exports["brdf", "bsdf-spectral"] = Export(f"{_HERE}.rgl:export_spectral")
    registry.exports["brdf", "mitsuba"] = Export(f"{_HERE}.scene:export")
    for kind in ("merl", "bsdf", "bsdf-spectral"):
        registry.file_exports[kind] = Entry(
            f"{_HERE}.convert:write", help="MERL tables, RGL files, NBRDF networks, folders of them"
        )
