"""Spectra as colours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from data_tools.readers.colours import colour_science

Array = NDArray[np.float64]


def spectra_to_rgb(wavelengths: Array) -> Array:
    """The matrix [W, 3] that turns reflectance at some wavelengths into colour, multiplied with from the right.

    Between wavelengths reflectance is linear, beyond the last ones constant. A perfect white is (1, 1, 1).

    Args:
        wavelengths: in nm, ascending, [W].

    Returns:
        To linear RGB (sRGB primaries), of a material in D65 for the CIE 1931 2 degree observer.
    """
    colour = colour_science()
    line = np.arange(360.0, 831.0)
    shape = colour.SpectralShape(line[0], line[-1], 1)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values
    light = colour.SDS_ILLUMINANTS["D65"].copy().align(shape).values[:, None]
    # each column: how much of each nanometre a measured wavelength stands for
    share = np.stack([np.interp(line, wavelengths, row) for row in np.eye(len(wavelengths))], 1)
    xyz = share.T @ (observer * light / (observer[:, 1:2] * light).sum())
    result: Array = xyz @ colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB.T
    white: Array = result.sum(0)
    return result / white  # D65 as tabulated is white to four digits
