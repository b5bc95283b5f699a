"""The default texture set: procedural materials, each photographed from above in distant light.

Families take turns, so any count of 20 or more holds them all; every draw is another material. Training and test draws
come from other random streams.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import torch

from data_tools.random_streams import Rng
from data_tools.synthetic.patterns.fields import blur_periodic, height_slopes
from data_tools.synthetic.random_values import Field, between, log_between
from data_tools.synthetic.stationary.families import FAMILIES, Split, split_draws
from data_tools.synthetic.stationary.periodic_maps import PeriodicMaps
from metapp.learning.task import Task

UNITS = {"image": "sRGB, 0 .. 255; a photograph from above"}
COUNTS: dict[Split, int] = {"train": 240, "test": 20}

SIZE = 256  # px a side
_SHADOW_STEPS = 12


def synthetic_tasks(split: Split, count: int, seed: int = 0, size: int = SIZE) -> Iterator[Task]:
    """The textures of one split, one by one.

    Args:
        split: "train" or "test"; the same families, other draws.
        count: how many. A larger set begins with the smaller one.
        seed: of all draws, >= 0.
        size: px a side of the pictures; another size draws other pictures of the same families.

    Returns:
        Tasks with unique names such as "bricks-013" ("bricks-t013" in the test split) and `image`, uint8
        [3, 256, 256], sRGB.

    Raises:
        ValueError: for another split, or a negative count or seed.
    """
    for family, name, rng in split_draws("textures", FAMILIES, COUNTS, split, count, seed):
        image = photograph_from_above(FAMILIES[family](rng, size), rng)
        yield Task(name, {"image": torch.from_numpy(image)})


def photograph_from_above(maps: PeriodicMaps, rng: Rng) -> npt.NDArray[np.uint8]:
    """A picture of a flat material from above, far away, in sunlight and skylight.

    Args:
        maps: of the material, [.., S, S].
        rng: of the sun's direction and colour, and of the exposure.

    Returns:
        uint8 [3, S, S], sRGB; its brightest parts are about to clip, its mean is neither black nor white.
    """
    elevation, azimuth = math.asin(between(rng, 0.45, 0.97)), between(rng, 0, math.tau)
    sun = (math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation))
    height = maps.height[0]
    along_x, along_y = height_slopes(height)
    length = np.sqrt(1 + along_x**2 + along_y**2)
    facing = np.clip((sun[2] - along_x * sun[0] - along_y * sun[1]) / length, 0, None)
    warm = between(rng, -0.12, 0.12)
    sunlight = np.array([1 + warm, 1, 1 - warm], np.float32)[:, None, None] * between(rng, 0.5, 1.0)
    skylight = np.array([1 - warm, 1, 1 + warm], np.float32)[:, None, None] * between(rng, 0.25, 0.6)
    lit = sunlight * (facing * _sunlit(height, sun))
    sky = skylight * (_openness(height) * (0.5 + 0.5 / length))
    turn = between(rng, 0, math.tau)  # the sky is brighter on one side, which metal shows
    bright_side = 1 + 1.5 * (along_x * math.cos(turn) + along_y * math.sin(turn))
    gloss = _highlight(maps, along_x, along_y, sun) * sunlight + maps.specular * sky * np.clip(bright_side, 0.2, 2)
    seen = maps.diffuse * (lit + sky) + gloss
    sharpness = between(rng, 0.4, 0.7) / len(height)  # of the lens; it also smooths jagged edges
    return _exposed(np.stack([blur_periodic(channel, sharpness) for channel in seen]), rng)


def _sunlit(height: Field, sun: tuple[float, float, float]) -> Field:
    """1 where the sun is seen, 0 where a higher place hides it [S, S]."""
    across = math.hypot(sun[0], sun[1])
    above = np.full_like(height, -1e9)
    for index in range(1, _SHADOW_STEPS + 1):
        reach = 0.8 * index**1.15  # texels; fine near by, coarser further off
        rows, columns = round(-reach * sun[1] / across), round(-reach * sun[0] / across)
        above = np.maximum(above, np.roll(height, (rows, columns), (0, 1)) - np.float32(reach * sun[2] / across))
    return np.clip(1 - (above - height) * np.float32(0.8), 0.1, 1)


def _openness(height: Field) -> Field:
    """How much sky a place sees [S, S], about: less where its surroundings are higher."""
    size = height.shape[0]
    hidden = np.zeros_like(height)
    for texels in (1.5, 5.0):
        hidden += np.clip(blur_periodic(height, texels / size) - height, 0, None) / np.float32(texels)
    result: Field = np.exp(np.float32(-1.5) * hidden)
    return result


def _highlight(maps: PeriodicMaps, along_x: Field, along_y: Field, sun: tuple[float, float, float]) -> Field:
    """Reflection of the sun by GGX [S, S], seen from above, without its Fresnel and shadowing."""
    half = np.array([sun[0], sun[1], sun[2] + 1])
    half /= np.linalg.norm(half)
    cosine2 = (half[2] - along_x * half[0] - along_y * half[1]) ** 2 / (1 + along_x**2 + along_y**2)
    alpha2 = np.maximum(maps.roughness[0] ** 4, 1e-3)
    density = alpha2 / (math.pi * (cosine2 * (alpha2 - 1) + 1) ** 2)
    result: Field = (maps.specular[0] * np.minimum(density, 5) * (math.pi / 4)).astype(np.float32)
    return result


def _exposed(linear_rgb: Field, rng: Rng) -> npt.NDArray[np.uint8]:
    """Linear RGB [3, S, S], any scale, to sRGB in uint8: the mean at a drawn level, the brightest rolled off."""
    level = log_between(rng, 0.13, 0.4)
    exposure = min(level / float(linear_rgb.mean()), 1.6 / float(np.quantile(linear_rgb[:, ::4, ::4], 0.99)))
    linear = np.clip(linear_rgb * np.float32(exposure), 0, None)
    linear = np.where(linear < 0.7, linear, 1 - 0.3 * np.exp((0.7 - linear) / np.float32(0.3)))
    srgb = np.where(linear < 0.0031308, 12.92 * linear, 1.055 * linear ** np.float32(1 / 2.4) - 0.055)
    result: npt.NDArray[np.uint8] = np.round(255 * np.clip(srgb, 0, 1)).astype(np.uint8)
    return result
