"""Polynomial Texture Maps (Malzbender et al. 2001): six coefficients a pixel and channel, `.ptm`, version 1.2.

A display value under a lamp in direction (x, y, z) is a polynomial of x and y. The file has six lines of text, then for
each channel the pixels from the bottom row, left to right, with a byte for each coefficient in the order of
:func:`polynomial_terms`. A byte b stands for (b - bias) scale, in display values of 0 to 255, bias and scale being of
the coefficient.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from metapp.apps.svbrdf_nonstationary.rti.light_curves import curve_directions
from metapp.apps.svbrdf_nonstationary.rti.light_process import LightProcess, mix_photos
from metapp.apps.svbrdf_nonstationary.rti.lit_photos import LitPhotos
from metapp.storage.files import add_suffix, write_atomically

LEAST_SCALE = 1e-6  # of a coefficient that is 0 at all pixels


def write_ptm(asset: LitPhotos, path: Path, provenance: Mapping[str, object]) -> None:
    """Write <path>.ptm, in the form PTM_FORMAT_RGB: 18 bytes a pixel."""
    photos = asset.photos
    coefficients = mix_photos(coefficient_weights(asset.process, asset.lamps), photos) * 255
    scales, biases = zip(*(choose_scale(coefficient) for coefficient in coefficients), strict=True)
    levels = torch.empty(coefficients.shape, dtype=torch.uint8)
    for level, coefficient, scale, bias in zip(levels, coefficients, scales, biases, strict=True):
        level[:] = (coefficient / scale + bias).round().clamp(0, 255)
    height, width = photos.shape[-2:]
    header = ["PTM_1.2", "PTM_FORMAT_RGB", width, height, " ".join(f"{scale:.8g}" for scale in scales)]
    text = "".join(f"{line}\n" for line in (*header, " ".join(map(str, biases))))

    def write(partial: Path) -> None:
        with partial.open("wb") as file:
            file.write(text.encode())
            for channel in levels.flip(2).unbind(1):
                file.write(channel.movedim(0, -1).contiguous().numpy().data)

    write_atomically(add_suffix(path, ".ptm"), write)


def polynomial_terms(directions: Tensor) -> Tensor:
    """Return the terms of the polynomials in directions, unit vectors [M, 3], in the order of files: [M, 6]."""
    x, y = directions[:, 0], directions[:, 1]
    return torch.stack([x * x, y * y, x * y, x, y, torch.ones_like(x)], 1)


def coefficient_weights(process: LightProcess, lamps: Tensor) -> Tensor:
    """Return the weights of N photographs in each coefficient, [6, N].

    Args:
        process: predicts photographs under other lamps.
        lamps: unit vectors towards the lamps of the photographs, [N, 3].
    """
    # By least squares over predicted pictures, evenly spread: so left-out photographs of 18 rendered domes are
    # predicted to 23.8 dB, by least squares over the photographs, most of which have low lamps, to 22.3 dB.
    directions = curve_directions()
    pictures = process.interpolation(directions, lamps).double()
    weights: Tensor = torch.linalg.lstsq(polynomial_terms(directions.double()), pictures).solution
    return weights.float()


def choose_scale(coefficient: Tensor) -> tuple[float, int]:
    """Return a scale and a whole bias by which the bytes 0 to 255 stand for all values of a coefficient, and for 0.

    >>> choose_scale(torch.tensor([-127.0, 127.0]))
    (1.0, 127)
    """
    low, high = min(0.0, float(coefficient.min())), max(0.0, float(coefficient.max()))
    # 254 steps, since rounding the bias shifts all values by up to half a step
    scale = max((high - low) / 254, LEAST_SCALE)
    return scale, round(-low / scale)
