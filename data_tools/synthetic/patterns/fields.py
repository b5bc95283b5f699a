"""Periodic fields on the unit tile: noise, blurs and colour ramps that the procedural materials are made of.

Fields are float32 [S, S] of texel centres, rows downwards. Everything repeats after one tile, so a field has no border.
"""

from __future__ import annotations

import functools

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.random_values import Field, uniforms


@functools.lru_cache(maxsize=4)
def texel_centres(size: int) -> tuple[Field, Field]:
    """Return the coordinates x and y of texel centres, each [S, S], in tiles, within (0, 1)."""
    centres = (np.arange(size, dtype=np.float32) + np.float32(0.5)) / np.float32(size)
    x, y = np.meshgrid(centres, centres)
    x.flags.writeable = y.flags.writeable = False
    return x, y


@functools.lru_cache(maxsize=4)
def _frequencies(size: int) -> tuple[Field, Field]:
    """Return the frequencies of a real transform [S, S/2 + 1], in cycles per tile, along x and y."""
    along_x = np.fft.rfftfreq(size, 1 / size).astype(np.float32)
    along_y = np.fft.fftfreq(size, 1 / size).astype(np.float32)
    fx, fy = np.meshgrid(along_x, along_y)
    return fx, fy


def _shaped_noise(rng: Rng, size: int, amplitude: Field) -> Field:
    """Draw noise with a given amplitude spectrum; mean 0, variance 1."""
    spectrum = np.fft.rfft2(uniforms(rng, size, size) - np.float32(0.5)) * amplitude
    spectrum[0, 0] = 0
    field: Field = np.fft.irfft2(spectrum, s=(size, size)).astype(np.float32)
    return field / max(float(field.std()), 1e-12)


def _radius(size: int, stretch: float, angle_rad: float) -> Field:
    """Return the frequency in cycles per tile, for structure `stretch` times as long along the angle as across it."""
    fx, fy = _frequencies(size)
    if stretch == 1:
        return np.hypot(fx, fy)
    cos, sin = np.float32(np.cos(angle_rad)), np.float32(np.sin(angle_rad))
    return np.hypot((fx * cos + fy * sin) * np.float32(stretch), fy * cos - fx * sin)


def band_noise(
    rng: Rng, size: int, frequency: float, octaves: float = 0.5, stretch: float = 1.0, angle_rad: float = 0.0
) -> Field:
    """Draw Gaussian noise of one scale.

    Args:
        rng: random numbers for the noise.
        size: S, texels along a side of the tile.
        frequency: middle of the band in cycles per tile; across the angle, if stretched.
        octaves: width of the band (a standard deviation).
        stretch: how many times longer structure is along the angle than across it.
        angle_rad: direction of the long side, from x towards y.

    Returns:
        [S, S], mean 0, variance 1.
    """
    radius = np.maximum(_radius(size, stretch, angle_rad), np.float32(1e-3))
    return _shaped_noise(rng, size, np.exp(-0.5 * (np.log2(radius / frequency) / octaves) ** 2) / radius)


def fbm(
    rng: Rng, size: int, frequency: float, slope: float = 2.0, stretch: float = 1.0, angle_rad: float = 0.0
) -> Field:
    """Draw noise of all scales finer than a coarsest one: fractional Brownian motion.

    Args:
        rng: random numbers for the noise.
        size: S, texels along a side of the tile.
        frequency: frequency of the coarsest structure in cycles per tile.
        slope: the amplitude falls with f^-slope beyond `frequency` (1: rough, 3: soft).
        stretch: how many times longer structure is along the angle than across it.
        angle_rad: direction of the long side, from x towards y.

    Returns:
        [S, S], mean 0, variance 1.
    """
    radius = _radius(size, stretch, angle_rad) / np.float32(frequency)
    # Frequencies far below the first are left out: they would make one part of the tile unlike another.
    low_cut = radius**2 / (radius**2 + np.float32(0.25))
    return _shaped_noise(rng, size, low_cut * (1 + radius**2) ** np.float32(-slope / 2))


def smooth_displacement(rng: Rng, size: int, frequency: float, amount: float) -> tuple[Field, Field]:
    """Draw a smooth displacement along and across, two fields [S, S] of standard deviation `amount`."""
    along, across = fbm(rng, size, frequency, 3.2), fbm(rng, size, frequency, 3.2)
    return along * np.float32(amount), across * np.float32(amount)


def ridges(field: Field, width: float) -> Field:
    """Return lines where a noise of variance 1 crosses zero: 1 on the line, falling to 0 at about `width` from it."""
    result: Field = np.exp(-((field / np.float32(width)) ** 2))
    return result


def normal_to_uniform(field: Field) -> Field:
    """Map a noise of variance 1 to (0, 1), roughly evenly, by the logistic nearest to the normal distribution."""
    result: Field = 1 / (1 + np.exp(np.float32(-1.702) * np.clip(field, -8, 8)))
    return result


def smoothstep(field: Field, low: float | Field, high: float | Field) -> Field:
    """Return 0 below low, 1 above high, and a smooth transition between; it falls if high < low."""
    t = np.clip((field - low) / (high - low), 0, 1).astype(np.float32)
    return t * t * (3 - 2 * t)


def mix(first: Field, second: Field, weight: Field | float) -> Field:
    """Interpolate from the first field (weight 0) to the second (weight 1)."""
    return first + (second - first) * np.asarray(weight, dtype=np.float32)


def blur_periodic(field: Field, sigma: float) -> Field:
    """Blur a periodic field by a Gaussian, sigma in tiles."""
    size = field.shape[-1]
    fx, fy = _frequencies(size)
    kernel = np.exp(np.float32(-2 * np.pi**2 * sigma**2) * (fx**2 + fy**2))
    return np.fft.irfft2(np.fft.rfft2(field) * kernel, s=(size, size)).astype(np.float32)


def height_slopes(height: Field) -> tuple[Field, Field]:
    """Return the slopes of a height [S, S] along x and y, by periodic central differences.

    A height in texels gives true slopes.
    """
    along_x = (np.roll(height, -1, 1) - np.roll(height, 1, 1)) / 2
    along_y = (np.roll(height, -1, 0) - np.roll(height, 1, 0)) / 2
    return along_x, along_y


def colour_ramp(values: Field, colours: Field) -> Field:
    """Interpolate colours [K, 3], K >= 1, spread over [0, 1], at values [S, S]: [3, S, S]."""
    places = np.clip(values, 0, 1) * (len(colours) - 1)
    lower = np.minimum(places.astype(np.int64), max(len(colours) - 2, 0))
    upper = np.minimum(lower + 1, len(colours) - 1)
    fraction = (places - lower).astype(np.float32)
    return np.stack([mix(channel[lower], channel[upper], fraction) for channel in colours.T])
