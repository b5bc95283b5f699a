"""Spectral files of the RGL database: reflectance at some wavelengths as linear RGB of the material in D65, and back.

Mitsuba's `measured` loads colours in RGB variants alone and spectra in spectral ones alone, and no file serves both.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from metapp.appearance.colorimetry import spectrum_to_rgb_matrix
from metapp.extensions.rgl.tensor_file import TensorFields

WAVELENGTHS_NM = np.arange(400.0, 701.0, 25.0)  # nm, of spectra made of colours; 30 nm apart no smooth ones were found
NEGATIVE_ROUNDING = 1e-9  # below 0: rounding
MAX_SPECTRUM_SOLVES = 100  # at most; 4 are taken


def fields_in_rgb(fields: TensorFields) -> dict[str, NDArray[np.number]]:
    """A file's fields with colours `rgb` [P, T, 3, V, U] in place of `spectra` [P, T, W, V, U].

    Colours that the file has are kept; of spectra, parts outside of Rec.709 are 0.
    """
    rest = {name: values for name, values in fields.items() if name not in ("spectra", "wavelengths")}
    if "rgb" in fields:
        return rest
    matrix = spectrum_to_rgb_matrix(fields["wavelengths"].astype(np.float64)).astype(np.float32)
    colours = np.einsum("ptwvu,wc->ptcvu", fields["spectra"], matrix, optimize=True).clip(0)
    return rest | {"rgb": np.ascontiguousarray(colours, np.float32)}


def fields_in_spectra(fields: TensorFields) -> dict[str, NDArray[np.number]]:
    """A file's fields with `spectra` at WAVELENGTHS in place of colours `rgb`, as `primary_spectra` has them.

    Spectra that the file has are kept; negative reflectance becomes 0.
    """
    rest = {name: values for name, values in fields.items() if name != "rgb"}
    if "spectra" in fields:
        return rest
    spectra = np.einsum("ptcvu,cw->ptwvu", fields["rgb"], primary_spectra().astype(np.float32), optimize=True).clip(0)
    return rest | {
        "wavelengths": WAVELENGTHS_NM.astype(np.float32),
        "spectra": np.ascontiguousarray(spectra, np.float32),
    }


@functools.cache
def primary_spectra() -> NDArray[np.float64]:
    """Reflectance spectra [3, W] at WAVELENGTHS whose sums, weighted by linear RGB, have that colour in D65.

    They are the smoothest that lie in [0, 1] and add up to 1, so that gray is flat, as those of Mallett and Yuksel
    2019, "Spectral Primary Decomposition for Rendering with sRGB Reflectance"; colours are exact at these wavelengths.
    """
    matrix, count = spectrum_to_rgb_matrix(WAVELENGTHS_NM), len(WAVELENGTHS_NM)
    slopes = np.diff(np.eye(count), axis=0)
    roughness = np.kron(np.eye(3), slopes.T @ slopes)
    colours, sums = np.kron(np.eye(3), matrix.T), np.kron(np.ones((1, 3)), np.eye(count))
    is_zero = np.zeros(3 * count, bool)
    for _ in range(MAX_SPECTRUM_SOLVES):  # least squares under equations; what comes out negative is held at 0
        equations = np.vstack([colours, sums, np.eye(3 * count)[is_zero]])
        values = np.concatenate([np.eye(3).ravel(), np.ones(count), np.zeros(is_zero.sum())])
        corner = np.zeros((len(equations), len(equations)))
        system = np.block([[roughness, equations.T], [equations, corner]])
        found = np.linalg.lstsq(system, np.concatenate([np.zeros(3 * count), values]), rcond=None)[0][: 3 * count]
        if found.min() >= -NEGATIVE_ROUNDING:
            break
        is_zero |= found < -NEGATIVE_ROUNDING
    result: NDArray[np.float64] = found.reshape(3, count).clip(0)
    return result
