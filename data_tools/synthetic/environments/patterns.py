"""Vectors, colours of light, and noises that skies and surfaces look up.

The noises are drawn once for all maps, so that a map takes little time. Scenes are not known here.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from data_tools.random_streams import random_stream
from data_tools.synthetic.patterns.fields import fbm
from data_tools.synthetic.random_values import Field

BLACK = np.zeros(3, np.float32)

_SIZE = 256  # px a side of the noises
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
_XYZ_TO_RGB = np.array(
    [[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]],
    np.float32,
)


def vector(*values: float) -> Field:
    """Return numbers as a float32 array."""
    return np.array(values, np.float32)


def direction(elevation_rad: float, azimuth_rad: float) -> Field:
    """Return the unit vector [3] of an elevation above the horizon and an azimuth: 0 is +x, a quarter turn +z."""
    horizontal = math.cos(elevation_rad)
    return vector(horizontal * math.cos(azimuth_rad), math.sin(elevation_rad), horizontal * math.sin(azimuth_rad))


def luminance(linear_rgb: Field) -> Field:
    """Return the luminance [...] of linear RGB [3, ...]."""
    return np.tensordot(_LUMINANCE, linear_rgb, 1)


def xyy_to_rgb(luminances: Field, x: Field, y: Field) -> Field:
    """Convert luminances and CIE 1931 chromaticities, each [N], to linear RGB [3, N] > 0."""
    scale = luminances / y
    linear_rgb = _XYZ_TO_RGB @ np.stack([x * scale, luminances, (1 - x - y) * scale])
    result: Field = np.maximum(linear_rgb, np.float32(1e-3) * luminances)
    return result


def black_body_rgb(kelvin: float) -> Field:
    """Return the linear RGB [3] of a black body of 1700 to 20000 K, of luminance 1.

    The chromaticity is Kim et al.'s (2002) fit of the Planckian locus.
    """
    inverse = 1e3 / kelvin
    if kelvin < 4000:
        x = ((-0.2661239 * inverse - 0.2343589) * inverse + 0.8776956) * inverse + 0.179910
    else:
        x = ((-3.0258469 * inverse + 2.1070379) * inverse + 0.2226347) * inverse + 0.240390
    if kelvin < 2222:
        y = ((-1.1063814 * x - 1.34811020) * x + 2.18555832) * x - 0.20219683
    elif kelvin < 4000:
        y = ((-0.9549476 * x - 1.37418593) * x + 2.09137015) * x - 0.16748867
    else:
        y = ((3.0817580 * x - 5.87338670) * x + 3.75112997) * x - 0.37001483
    return xyy_to_rgb(vector(1), vector(x), vector(y))[:, 0]


@functools.lru_cache(maxsize=1)
def shared_noises() -> dict[str, Field]:
    """Return periodic noises [256, 256] that all maps look up, each at other places; mean 0, variance 1."""
    rng = random_stream(8)
    fields = {
        "soft": fbm(rng, _SIZE, 3, 2.6),
        "cloud": fbm(rng, _SIZE, 2.5, 1.9),
        "rough": fbm(rng, _SIZE, 4, 1.4),
        "leaves": fbm(rng, _SIZE, 14, 1.5),
        "planks": fbm(rng, _SIZE, 14, 1.8, stretch=9),
    }
    for field in fields.values():
        field.flags.writeable = False
    return fields


def look_up_noise(noise: str, across: Field, along: Field | float) -> Field:
    """Return the values [N] of a noise at places [N] in tiles, from the nearest texel."""
    columns = np.floor(across * np.float32(_SIZE)).astype(np.int64) & (_SIZE - 1)
    rows = np.floor(along * np.float32(_SIZE)).astype(np.int64) & (_SIZE - 1)
    values: Field = shared_noises()[noise].ravel()[rows * _SIZE + columns]
    return values


def hash_numbers(numbers: Field, key: float) -> Field:
    """Return a number in [0, 1) for each whole number [N], without order."""
    mixed = (numbers.astype(np.int64) + int(key * 65536)) * 0x9E3779B1 & 0xFFFFFFFF
    mixed = (mixed ^ (mixed >> 15)) * 0x85EBCA6B & 0xFFFFFFFF
    return ((mixed ^ (mixed >> 13)) & 0xFFFF).astype(np.float32) / np.float32(65536)
