"""Help and options of `metapp data bsdf`, apart from the reader in `rgl`, so that help imports nothing large."""

from __future__ import annotations

from dataclasses import dataclass

from data_tools.converters import SamplesOption
from metapp.options import Converter


@dataclass(frozen=True)
class BsdfConverter(Converter):
    """Convert RGL measurements of BRDFs, isotropic or anisotropic.

    A file of the RGL material database (Dupuy and Jakob 2018), _rgb.bsdf or _spec.bsdf, is evaluated by Mitsuba and
    becomes samples above the horizon (angles in rad, reflectance in 1/sr, linear RGB; of spectra under D65).
    A bad file that you name ends the conversion, and nothing is written; one found in a folder is skipped with a
    warning.

    Examples:
      metapp data bsdf chm_orange_rgb.bsdf --out rgl
      metapp data bsdf measurements --split test --out rgl
    """

    samples: SamplesOption = 65_536
