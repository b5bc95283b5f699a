"""Colorimetry by the package colour-science: spectra as linear RGB, and colour differences.

The package takes a second to import, so fits must not use this module; only readers of files and measures of pictures
do.
"""

from __future__ import annotations

import sys
import warnings
from types import ModuleType
from unittest.mock import NonCallableMock

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def import_colour_science() -> ModuleType:
    """Import colour-science without its warning of a missing SciPy, which nothing here needs.

    It may not see OpenImageIO: references to it would be reported as leaks when Python ends. The mocks that it
    leaves in place of SciPy are removed: other libraries would take them for the package.
    """
    import OpenImageIO as oiio

    sys.modules["OpenImageIO"] = None  # type: ignore[assignment]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import colour
    finally:
        sys.modules["OpenImageIO"] = oiio
    for name in [name for name, module in sys.modules.items() if isinstance(module, NonCallableMock)]:
        del sys.modules[name]
    return colour


def spectrum_to_rgb_matrix(wavelengths: Array) -> Array:
    """Compute the matrix [W, 3] that turns reflectance at some wavelengths into colour, multiplied with from the right.

    Between wavelengths reflectance is linear, beyond the last ones constant. A perfect white is (1, 1, 1).

    Args:
        wavelengths: in nm, ascending, [W].

    Returns:
        To linear RGB (sRGB primaries), of a material in D65 for the CIE 1931 2 degree observer.
    """
    colour = import_colour_science()
    shape = colour.SpectralShape(360, 830, 1)
    # each row: the share of each nanometre that a measured wavelength stands for
    shares = np.stack([np.interp(shape.wavelengths, wavelengths, row) for row in np.eye(len(wavelengths))])
    with warnings.catch_warnings(
        action="ignore", category=colour.utilities.ColourRuntimeWarning
    ):  # it warns that D65 is resampled
        light = colour.SDS_ILLUMINANTS["D65"]
        xyz = colour.msds_to_XYZ(shares, illuminant=light, method="Integration", shape=shape) / 100
    rgb_matrix: Array = colour.XYZ_to_RGB(xyz, "sRGB")
    white: Array = rgb_matrix.sum(0)
    return rgb_matrix / white  # D65 as tabulated is white to four digits


def colour_difference(pictures: Array, references: Array) -> Array:
    """Compute CIE 2000 colour differences (CIEDE2000, all weights 1) under D65, [...].

    Args:
        pictures: display values in [0, 1], sRGB [..., 3].
        references: display values in [0, 1], sRGB [..., 3].
    """
    colour = import_colour_science()
    labs = [colour.XYZ_to_Lab(colour.sRGB_to_XYZ(colours)) for colours in (pictures, references)]
    differences: Array = colour.delta_E(*labs, method="CIE 2000")
    return differences
