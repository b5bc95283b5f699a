"""The default set of stationary svBRDFs: procedural materials, each in one photo under the flash of a phone.

Families take turns, so any count of 16 or more holds them all; every draw is another material. Training and test draws
come from other random streams. A training task holds a photo and, for the outer loss alone, statistics of the maps
behind it; a test task also the material under other lights, for judging.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from data_tools.random_streams import Rng
from data_tools.readers.flash_photos import UNITS as OF_PHOTOS
from data_tools.synthetic.random_values import Split, between, log_between, uniforms
from data_tools.synthetic.stationary.families import FAMILIES, split_draws
from data_tools.synthetic.stationary.periodic_maps import PeriodicMaps
from metapp.appearance.colour import radiance_to_display
from metapp.appearance.flash import camera_position, relighting_positions, render_maps, texel_positions
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.svbrdf_maps import STATISTICS_SIDES_PX, Maps, map_statistics, pack_maps
from metapp.learning.task import Task

COUNTS: dict[Split, int] = {"train": 120, "test": 16}
UNITS = {
    **OF_PHOTOS,
    "relit": "photographs under other lights, sRGB display values 0..255, [3, 3, S, S]; test tasks only",
    "truth": "statistics of the maps under the photo's exposure, at 256, 128 and 64 px, float32 [3, 2, 6] as of "
    "metapp.appearance.svbrdf_maps.map_statistics; training tasks only",
    "maps": "the maps under the photo's exposure, float16 [10, S, S], packed by "
    "metapp.appearance.svbrdf_maps.pack_maps; training tasks only, where they are asked for",
}

# Families that are flat enough to be maps on a plane: without loose grass, leaves, and materials that are mostly print.
FLAT_FAMILIES = tuple(name for name in FAMILIES if name not in ("grass", "foliage", "stripes", "camouflage"))

SIZE = 256  # px a side
_STREAM = 1  # a key of the random streams: other materials than in the set of textures


def synthetic_tasks(split: Split, count: int, seed: int = 0, size: int = SIZE, *, maps: bool = False) -> Iterator[Task]:
    """Draw the materials of one split, and yield each one's photo as a task.

    Args:
        split: "train" or "test"; both have all families, with other draws.
        count: how many. A larger set begins with the smaller one.
        seed: seed of all draws, >= 0.
        size: px a side of the pictures; another size draws other pictures of the families.
        maps: whether training tasks also hold their maps.

    Returns:
        Tasks with unique names such as "bricks-016" ("bricks-t000" in the test split) and `image`, uint8
        [3, size, size], sRGB. Training tasks also hold `truth`, float32 [3, 2, 6], and if they are asked for `maps`,
        float16 [10, size, size]; test tasks hold `relit`, uint8 [3, 3, size, size], the material at the photo's
        exposure under `metapp.appearance.flash.relighting_positions`.

    Raises:
        ValueError: for another split, or a negative count or seed.
    """
    for family, name, rng in split_draws("svBRDFs", FLAT_FAMILIES, COUNTS, split, count, seed, _STREAM):
        shots = take_flash_photos(FAMILIES[family](rng, size), rng)
        if split == "test":
            known = {"relit": shots.relit}
        else:
            known = {"truth": map_statistics_of_sides(shots.maps)}
            known |= {"maps": pack_maps(shots.maps).half()} if maps else {}
        yield Task(name, {"image": shots.photo} | known)


class FlashShots(NamedTuple):
    """Photographs of a material.

    Attributes:
        photo: uint8 [3, S, S], gamma-encoded (2.2): the highlight is about to clip, the rest neither black nor white.
        relit: uint8 [3, 3, S, S], at the photo's exposure without noise, under
            `metapp.appearance.flash.relighting_positions`.
        maps: the maps [C, S, S] that make the photo's picture at exposure 1.
    """

    photo: Tensor
    relit: Tensor
    maps: Maps


@torch.no_grad()
def take_flash_photos(maps: PeriodicMaps, rng: Rng) -> FlashShots:
    """Take a photo of a material with a phone straight above it, its flash beside the lens, and relight the material.

    Args:
        maps: maps of the material, [.., S, S].
        rng: random numbers for the flash's exact place and cone, the exposure and the sensor's noise.
    """
    diffuse, specular, roughness, height = (torch.from_numpy(pictures) for pictures in maps)
    size = height.shape[-1]
    surface = Maps(diffuse, specular, roughness.clamp_min(0.15), normal_from_height(height, 0.7))
    flash = camera_position() + torch.tensor([between(rng, -0.06, 0.06), between(rng, -0.06, 0.06), 0.0])
    positions, falloff = texel_positions(size, size), between(rng, 0.7, 1.3)
    radiance = render_maps(surface, positions, flash, camera_position(), falloff=falloff)
    luminance = radiance.mean(0)
    # A phone meters the whole picture and holds the highlight back: the darker exposure of the two is taken.
    metered = log_between(rng, 0.13, 0.3) / float(luminance.mean())
    held_back = 1 / float(luminance.quantile(between(rng, 0.985, 0.998)))
    exposure = min(metered, max(held_back, 0.08 / float(luminance.mean())))
    exposed = radiance * exposure
    # Photons (variance in proportion to the light) and read-out; the sum of four uniforms is nearly normal.
    normal = torch.from_numpy((uniforms(rng, 4, 3, size, size).sum(0) - 2) * np.float32(3**0.5))
    noise = log_between(rng, 0.003, 0.015)
    noisy_radiance = exposed + normal * (noise**2 * exposed + (0.15 * noise) ** 2).sqrt()
    relit_radiance = [
        render_maps(surface, positions, *light, falloff=falloff) * exposure for light in relighting_positions().values()
    ]
    photo, relit = (
        (radiance_to_display(pictures) * 255).round().to(torch.uint8)
        for pictures in (noisy_radiance, torch.stack(relit_radiance))
    )
    exposed_maps = surface._replace(
        diffuse=(surface.diffuse * exposure).clamp(0, 1), specular=(surface.specular * exposure).clamp(0, 1)
    )
    return FlashShots(photo, relit, exposed_maps)


def map_statistics_of_sides(maps: Maps) -> Tensor:
    """Return the statistics [3, 2, 6] of maps [C, S, S] at STATISTICS_SIDES_PX: 256, 128 and 64 px."""
    coarser_maps = (Maps(*(adaptive_avg_pool2d(field, size) for field in maps)) for size in STATISTICS_SIDES_PX)
    return torch.stack([map_statistics(field) for field in coarser_maps])
