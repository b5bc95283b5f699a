"""Spectral files of the RGL database: reflectance at some wavelengths as linear RGB of the material in D65."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metapp.appearance.colorimetry import spectra_to_rgb

VISIBLE = (420.0, 680.0)  # nm, that spectra must cover

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
