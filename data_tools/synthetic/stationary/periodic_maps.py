"""The maps of a periodic procedural material, and the draws of its colours and its relief.

Every family makes its maps by :func:`assemble_maps`, which keeps them in the ranges of plausible materials. No family
is known here.
"""

from __future__ import annotations

import colorsys
from typing import NamedTuple

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.patterns.fields import height_slopes
from data_tools.synthetic.random_values import Field, between, chance, log_between

Range = tuple[float, float]


class PeriodicMaps(NamedTuple):
    """A stationary, periodic material, all float32.

    Attributes:
        diffuse: linear RGB albedo [3, S, S] in [0, 1].
        specular: reflectance at normal incidence F0 [1, S, S] in [0.02, 0.9].
        roughness: [1, S, S] in [0.05, 1]; the alpha of GGX is its square.
        height: [1, S, S] in texels of these maps: the slope is the finite difference between texels, times 1.
    """

    diffuse: Field
    specular: Field
    roughness: Field
    height: Field


def assemble_maps(
    rng: Rng,
    diffuse: Field,
    height: Field,
    slope: Range,
    specular: Field | Range = (0.03, 0.06),
    roughness: Field | Range = (0.5, 0.95),
) -> PeriodicMaps:
    """Put a material together.

    Args:
        rng: random numbers for values that are given as a range.
        diffuse: linear RGB albedo [3, S, S], clamped to [0.01, 0.95].
        height: [S, S] of any scale.
        slope: range of the root mean square slope that the height is scaled to.
        specular: F0 [S, S], or the range of a constant.
        roughness: [S, S], or the range of a constant.
    """
    along_x, along_y = height_slopes(height)
    steepness = float(np.sqrt((along_x**2 + along_y**2).mean()))
    height = (height - height.mean()) * np.float32(log_between(rng, *slope) / max(steepness, 1e-9))

    def plane(values: Field | Range, low: float, high: float) -> Field:
        if isinstance(values, tuple):
            values = np.full(height.shape, between(rng, *values), np.float32)
        return np.clip(values, low, high)[None].astype(np.float32)

    return PeriodicMaps(
        np.clip(diffuse, 0.01, 0.95).astype(np.float32),
        plane(specular, 0.02, 0.9),
        plane(roughness, 0.05, 1.0),
        height[None].astype(np.float32),
    )


def draw_palette(rng: Rng, hexes: str, count: int, strange: float = 0.25) -> Field:
    """Draw colours that go together: some of the given ones, moved together in hue, saturation and lightness.

    Args:
        rng: random numbers for the colours.
        hexes: sRGB colours to start from, as in "8a6f4d c2b280".
        count: number of colours; they repeat, varied, if more are asked for than given.
        strange: in this share of draws the hue may be any.

    Returns:
        Linear RGB [count, 3] in [0, 1].
    """
    anchors = hexes.split()
    order = np.argsort(rng.random(len(anchors)))
    turn = float(rng.random()) if chance(rng, strange) else between(rng, -0.03, 0.03)
    richness, gamma = log_between(rng, 0.55, 1.5), log_between(rng, 0.65, 1.6)
    colours = []
    for index in range(count):
        anchor = anchors[order[index % len(anchors)]]
        red, green, blue = (int(anchor[digit : digit + 2], 16) / 255 for digit in (0, 2, 4))
        hue, saturation, value = colorsys.rgb_to_hsv(red, green, blue)
        hue = (hue + turn + between(rng, -0.015, 0.015)) % 1
        saturation = min(1.0, saturation * richness * between(rng, 0.85, 1.15))
        value = min(1.0, max(0.2, value**gamma) * between(rng, 0.88, 1.1))
        colours.append([channel**2.2 for channel in colorsys.hsv_to_rgb(hue, saturation, value)])
    return np.array(colours, np.float32)


def draw_dye_colours(rng: Rng, count: int, saturation: Range = (0.2, 0.95)) -> Field:
    """Draw colours of any hue, as dyes and paints have, that differ in lightness: linear RGB [count, 3]."""
    hue, spread = float(rng.random()), between(rng, 0.0, 0.5)
    values = np.linspace(between(rng, 0.1, 0.5), between(rng, 0.65, 1.0), count)
    values = values[np.argsort(rng.random(count))]
    colours = []
    for value in values:
        tone = (hue + spread * between(rng, -1, 1)) % 1
        depth = between(rng, *saturation) * (0.15 if chance(rng, 0.2) else 1.0)
        colours.append([channel**2.2 for channel in colorsys.hsv_to_rgb(tone, depth, float(value))])
    return np.array(colours, np.float32)


def uniform_colour(colour: Field, size: int) -> Field:
    """Return an albedo [3, S, S] that has one colour [3] everywhere."""
    return np.broadcast_to(colour[:, None, None], (3, size, size)).astype(np.float32)


def vary_albedo(diffuse: Field, field: Field, amount: float) -> Field:
    """Make an albedo lighter and darker by a field of variance 1; amount 0.1 is barely, 0.5 strongly visible."""
    result: Field = diffuse * np.exp(np.float32(amount) * np.clip(field, -3, 3))
    return result
