"""Spectral files of the RGL database: reflectance spectra as linear RGB of the material in D65, and back.

Mitsuba's `measured` loads colours in RGB variants alone and spectra in spectral ones alone, and no file serves both.
Shapes: P azimuths and T angles of the viewer, W wavelengths, V x U half vectors.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from metapp.appearance.colorimetry import spectrum_to_rgb_matrix
from metapp.extensions.rgl.tensor_file import TensorFields

# of spectra that are made from colours; at steps of 30 nm no smooth spectra were found
WAVELENGTHS_NM = np.arange(400.0, 701.0, 25.0)
NEGATIVE_ROUNDING = 1e-9  # reflectance that is negative by less is rounding
MAX_SPECTRUM_SOLVES = 100  # 4 are enough for WAVELENGTHS_NM


def fields_in_rgb(fields: TensorFields) -> dict[str, NDArray[np.number]]:
    """Return a file's fields with colours `rgb` [P, T, 3, V, U] in place of `spectra` [P, T, W, V, U].

    Colours that the file has are kept. Channels that are negative, of colours outside of Rec.709, become 0.
    """
    other_fields = {name: values for name, values in fields.items() if name not in ("spectra", "wavelengths")}
    if "rgb" in fields:
        return other_fields
    matrix = spectrum_to_rgb_matrix(fields["wavelengths"].astype(np.float64)).astype(np.float32)
    colours = np.einsum("ptwvu,wc->ptcvu", fields["spectra"], matrix, optimize=True).clip(0)
    return other_fields | {"rgb": np.ascontiguousarray(colours, np.float32)}


def fields_in_spectra(fields: TensorFields) -> dict[str, NDArray[np.number]]:
    """Return a file's fields with `spectra` [P, T, W, V, U] at WAVELENGTHS_NM in place of colours `rgb`.

    Spectra that the file has are kept. Others are sums of :func:`primary_spectra`, weighted by the colours; negative
    reflectance becomes 0.
    """
    other_fields = {name: values for name, values in fields.items() if name != "rgb"}
    if "spectra" in fields:
        return other_fields
    spectra = np.einsum("ptcvu,cw->ptwvu", fields["rgb"], primary_spectra().astype(np.float32), optimize=True).clip(0)
    return other_fields | {
        "wavelengths": WAVELENGTHS_NM.astype(np.float32),
        "spectra": np.ascontiguousarray(spectra, np.float32),
    }


@functools.cache
def primary_spectra() -> NDArray[np.float64]:
    """Compute reflectance spectra [3, W] at WAVELENGTHS_NM whose sum, weighted by linear RGB, has that colour in D65.

    They are the smoothest that lie in [0, 1] and add up to 1, so that gray is flat (Mallett and Yuksel 2019, "Spectral
    Primary Decomposition for Rendering with sRGB Reflectance"). Colours are exact for light at these wavelengths.
    """
    matrix, count = spectrum_to_rgb_matrix(WAVELENGTHS_NM), len(WAVELENGTHS_NM)
    slopes = np.diff(np.eye(count), axis=0)
    roughness = np.kron(np.eye(3), slopes.T @ slopes)
    colours, sums = np.kron(np.eye(3), matrix.T), np.kron(np.ones((1, 3)), np.eye(count))
    is_zero = np.zeros(3 * count, bool)
    for _ in range(MAX_SPECTRUM_SOLVES):  # constrained least squares; entries that come out negative are then held at 0
        equations = np.vstack([colours, sums, np.eye(3 * count)[is_zero]])
        right_sides = np.concatenate([np.eye(3).ravel(), np.ones(count), np.zeros(is_zero.sum())])
        zero_block = np.zeros((len(equations), len(equations)))
        system = np.block([[roughness, equations.T], [equations, zero_block]])
        solution = np.linalg.lstsq(system, np.concatenate([np.zeros(3 * count), right_sides]), rcond=None)[0][
            : 3 * count
        ]
        if solution.min() >= -NEGATIVE_ROUNDING:
            break
        is_zero |= solution < -NEGATIVE_ROUNDING
    result: NDArray[np.float64] = solution.reshape(3, count).clip(0)
    return result
