"""Spectral files of the RGL database: reflectance at some wavelengths as linear RGB of the material in D65, and back.

Mitsuba's `measured` loads colours in RGB variants alone and spectra in spectral ones alone, and no file serves both.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metapp.appearance.colorimetry import spectra_to_rgb

VISIBLE = (420.0, 680.0)  # nm, that spectra must cover
WAVELENGTHS = np.arange(400.0, 701.0, 25.0)  # nm, of spectra made of colours; 30 nm apart no smooth ones were found
SETTLED = 1e-9  # below 0: rounding
ROUNDS = 100  # at most; 4 are taken

Fields = Mapping[str, NDArray[np.number]]


def is_spectral(fields: Fields) -> bool:
    """Test whether a file has spectra and no colours."""
    return "spectra" in fields and "rgb" not in fields


def check_wavelengths(path: Path, wavelengths: NDArray[np.number]) -> None:
    """Refuse spectra that do not give a colour.

    Raises:
        ValueError: wavelengths that are not ascending, or do not cover visible light.
    """
    if (np.diff(wavelengths) <= 0).any():
        raise ValueError(f"{path}: wavelengths not ascending, expected ascending ones in nm; download it again.")
    first, last = float(wavelengths[0]), float(wavelengths[-1])
    if len(wavelengths) < 4 or first > VISIBLE[0] or last < VISIBLE[1]:
        raise ValueError(
            f"{path}: {len(wavelengths)} wavelengths from {first:g} to {last:g} nm, expected 4 or more that cover "
            f"{VISIBLE[0]:g} to {VISIBLE[1]:g} nm; take the file of that name that ends in _rgb.bsdf."
        )


def in_rgb(fields: Fields) -> dict[str, NDArray[np.number]]:
    """A file's fields with colours `rgb` [P, T, 3, V, U] in place of `spectra` [P, T, W, V, U].

    Colours that the file has are kept; of spectra, parts outside of Rec.709 are 0.

    Args:
        fields: as `check_wavelengths` allows.
    """
    rest = {name: values for name, values in fields.items() if name not in ("spectra", "wavelengths")}
    if not is_spectral(fields):
        return rest
    matrix = spectra_to_rgb(fields["wavelengths"].astype(np.float64)).astype(np.float32)
    colours = np.einsum("ptwvu,wc->ptcvu", fields["spectra"], matrix, optimize=True).clip(0)
    return rest | {"rgb": np.ascontiguousarray(colours, np.float32)}


def in_spectra(fields: Fields) -> dict[str, NDArray[np.number]]:
    """A file's fields with `spectra` at WAVELENGTHS in place of colours `rgb`, as `primaries` has them.

    Spectra that the file has are kept; negative reflectance becomes 0.
    """
    rest = {name: values for name, values in fields.items() if name != "rgb"}
    if "spectra" in fields:
        return rest
    spectra = np.einsum("ptcvu,cw->ptwvu", fields["rgb"], primaries().astype(np.float32), optimize=True).clip(0)
    return rest | {"wavelengths": WAVELENGTHS.astype(np.float32), "spectra": np.ascontiguousarray(spectra, np.float32)}


@functools.cache
def primaries() -> NDArray[np.float64]:
    """Reflectance spectra [3, W] at WAVELENGTHS whose sums, weighted by linear RGB, have that colour in D65.

    They are the smoothest that lie in [0, 1] and add up to 1, so that gray is flat, as those of Mallett and Yuksel
    2019, "Spectral Primary Decomposition for Rendering with sRGB Reflectance"; colours are exact at these wavelengths.
    """
    matrix, count = spectra_to_rgb(WAVELENGTHS), len(WAVELENGTHS)
    slopes = np.diff(np.eye(count), axis=0)
    roughness = np.kron(np.eye(3), slopes.T @ slopes)
    colours, sums = np.kron(np.eye(3), matrix.T), np.kron(np.ones((1, 3)), np.eye(count))
    is_zero = np.zeros(3 * count, bool)
    for _ in range(ROUNDS):  # least squares under equations; what comes out negative is held at 0
        equations = np.vstack([colours, sums, np.eye(3 * count)[is_zero]])
        values = np.concatenate([np.eye(3).ravel(), np.ones(count), np.zeros(is_zero.sum())])
        corner = np.zeros((len(equations), len(equations)))
        system = np.block([[roughness, equations.T], [equations, corner]])
        found = np.linalg.lstsq(system, np.concatenate([np.zeros(3 * count), values]), rcond=None)[0][: 3 * count]
        if found.min() >= -SETTLED:
            break
        is_zero |= found < -SETTLED
    result: NDArray[np.float64] = found.reshape(3, count).clip(0)
    return result
