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
from data_tools.synthetic.random_values import Field, Split, between, log_between
from data_tools.synthetic.stationary.families import FAMILIES, split_draws
from data_tools.synthetic.stationary.periodic_maps import PeriodicMaps
from metapp.learning.task import Task

UNITS = {"image": "sRGB, 0 .. 255; a photograph from above"}
COUNTS: dict[Split, int] = {"train": 240, "test": 20}

SIZE = 256  # px a side
_SHADOW_STEPS = 12  # places towards the sun that are tried as casters of a shadow


def synthetic_tasks(split: Split, count: int, seed: int = 0, size: int = SIZE) -> Iterator[Task]:
    """Draw the textures of one split, and yield each as a task.

    Args:
        split: "train" or "test"; both have all families, with other draws.
        count: how many. A larger set begins with the smaller one.
        seed: seed of all draws, >= 0.
        size: px a side of the pictures; another size draws other pictures of the families.

    Returns:
        Tasks with unique names such as "bricks-013" ("bricks-t013" in the test split) and `image`, uint8
        [3, size, size], sRGB.

    Raises:
        ValueError: for another split, or a negative count or seed.
    """
    for family, name, rng in split_draws("textures", FAMILIES, COUNTS, split, count, seed):
        image = photograph_from_above(FAMILIES[family](rng, size), rng)
        yield Task(name, {"image": torch.from_numpy(image)})


def photograph_from_above(maps: PeriodicMaps, rng: Rng) -> npt.NDArray[np.uint8]:
    """Take a picture of a flat material from above, far away, in sunlight and skylight.

    Args:
        maps: maps of the material, [.., S, S].
        rng: random numbers for the sun's direction and colour, and for the exposure.

    Returns:
        uint8 [3, S, S], sRGB; its brightest parts are about to clip, its mean is neither black nor white.
    """
    elevation, azimuth = math.asin(between(rng, 0.45, 0.97)), between(rng, 0, math.tau)
    sun = (math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation))
    height = maps.height[0]
    along_x, along_y = height_slopes(height)
    length = np.sqrt(1 + along_x**2 + along_y**2)
    facing = np.clip((sun[2] - along_x * sun[0] - along_y * sun[1]) / length, 0, None)
    warmth = between(rng, -0.12, 0.12)
    sunlight = np.array([1 + warmth, 1, 1 - warmth], np.float32)[:, None, None] * between(rng, 0.5, 1.0)
    skylight = np.array([1 - warmth, 1, 1 + warmth], np.float32)[:, None, None] * between(rng, 0.25, 0.6)
    sun_light = sunlight * (facing * _sun_visibility(height, sun))
    sky_light = skylight * (_openness(height) * (0.5 + 0.5 / length))
    bright_azimuth = between(rng, 0, math.tau)  # the sky is brighter on one side, which metal shows
    bright_side = 1 + 1.5 * (along_x * math.cos(bright_azimuth) + along_y * math.sin(bright_azimuth))
    gloss = _highlight(maps, along_x, along_y, sun) * sunlight + maps.specular * sky_light * np.clip(
        bright_side, 0.2, 2
    )
    radiance = maps.diffuse * (sun_light + sky_light) + gloss
    sharpness = between(rng, 0.4, 0.7) / len(height)  # of the lens; it also smooths jagged edges
    return _expose(np.stack([blur_periodic(channel, sharpness) for channel in radiance]), rng)


def _sun_visibility(height: Field, sun: tuple[float, float, float]) -> Field:
    """Return 1 where the sun is seen, down to 0.1 where a higher place hides it, [S, S]."""
    across = math.hypot(sun[0], sun[1])
    blocking_height = np.full_like(height, -1e9)
    for index in range(1, _SHADOW_STEPS + 1):
        distance = 0.8 * index**1.15  # texels; fine near by, coarser further off
        rows, columns = round(-distance * sun[1] / across), round(-distance * sun[0] / across)
        blocking_height = np.maximum(
            blocking_height, np.roll(height, (rows, columns), (0, 1)) - np.float32(distance * sun[2] / across)
        )
    return np.clip(1 - (blocking_height - height) * np.float32(0.8), 0.1, 1)


def _openness(height: Field) -> Field:
    """Return how much sky a place sees [S, S], about: less where its surroundings are higher."""
    size = height.shape[0]
    surrounding_slope = np.zeros_like(height)
    for texels in (1.5, 5.0):
        surrounding_slope += np.clip(blur_periodic(height, texels / size) - height, 0, None) / np.float32(texels)
    result: Field = np.exp(np.float32(-1.5) * surrounding_slope)
    return result


def _highlight(maps: PeriodicMaps, along_x: Field, along_y: Field, sun: tuple[float, float, float]) -> Field:
    """Return the reflection of the sun by GGX [S, S], seen from above, without its Fresnel and shadowing."""
    half = np.array([sun[0], sun[1], sun[2] + 1])
    half /= np.linalg.norm(half)
    cosine2 = (half[2] - along_x * half[0] - along_y * half[1]) ** 2 / (1 + along_x**2 + along_y**2)
    alpha2 = np.maximum(maps.roughness[0] ** 4, 1e-3)
    density = alpha2 / (math.pi * (cosine2 * (alpha2 - 1) + 1) ** 2)
    result: Field = (maps.specular[0] * np.minimum(density, 5) * (math.pi / 4)).astype(np.float32)
    return result


def _expose(linear_rgb: Field, rng: Rng) -> npt.NDArray[np.uint8]:
    """Convert linear RGB [3, S, S] of any scale to sRGB in uint8.

    The exposure brings the mean to a drawn level, and the brightest parts are rolled off.
    """
    level = log_between(rng, 0.13, 0.4)
    exposure = min(level / float(linear_rgb.mean()), 1.6 / float(np.quantile(linear_rgb[:, ::4, ::4], 0.99)))
    linear = np.clip(linear_rgb * np.float32(exposure), 0, None)
    linear = np.where(linear < 0.7, linear, 1 - 0.3 * np.exp((0.7 - linear) / np.float32(0.3)))
    srgb = np.where(linear < 0.0031308, 12.92 * linear, 1.055 * linear ** np.float32(1 / 2.4) - 0.055)
    result: npt.NDArray[np.uint8] = np.round(255 * np.clip(srgb, 0, 1)).astype(np.uint8)
    return result
