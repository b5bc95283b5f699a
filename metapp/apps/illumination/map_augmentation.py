"""Data augmentation of environment maps: turned, tinted and mixed maps, other contrasts, lamps.

All functions take and return linear radiance [T, 3, H, W].
"""

from __future__ import annotations

import torch
from torch import Generator, Tensor
from torch.nn.functional import relu

from metapp.appearance.latlong import mean_luminance
from metapp.learning.random_tensors import draw_normal, draw_uniform

# shares of the maps that get another contrast, that are mixed with another map, and that get lamps
REGRADED_SHARE, MIXED_SHARE, LAMPS_SHARE = 1 / 2, 1 / 3, 1 / 3
LAMP_COUNT, MAX_LOG_RADIANCE = 3, 6.5  # lamps of a map, and the log of the greatest radiance of a lamp


def normalise_luminance(maps: Tensor) -> Tensor:
    """Scale maps [T, 3, H, W] to a mean luminance of 1."""
    return maps / mean_luminance(maps)[:, None, None, None]


def vary_maps(maps: Tensor, rng: Generator) -> Tensor:
    """Change maps [T, 3, H, W] at random, each by some of the functions of this module; their mean luminance is 1."""
    maps = regrade_maps(tint_maps(turn_maps(maps, rng), rng), rng)
    return normalise_luminance(add_lamps(mix_maps(normalise_luminance(maps), rng), rng))


def turn_maps(maps: Tensor, rng: Generator) -> Tensor:
    """Turn maps [T, 3, H, W] about the vertical, and mirror half of them."""
    count, width = len(maps), maps.shape[-1]
    turns = torch.randint(width, (count, 1), generator=rng, device=rng.device)
    is_mirrored = draw_uniform(rng, count, 1) < 0.5
    columns = (torch.arange(width, device=rng.device) + turns) % width
    columns = torch.where(is_mirrored, columns.flip(1), columns)
    return maps.gather(3, columns[:, None, None].expand_as(maps))


def tint_maps(maps: Tensor, rng: Generator) -> Tensor:
    """Multiply each channel of maps [T, 3, H, W] by a random gain, about 15 % more or less."""
    return maps * torch.exp(0.15 * draw_normal(rng, len(maps), 3, 1, 1))


def regrade_maps(maps: Tensor, rng: Generator) -> Tensor:
    """Raise some of the maps [T, 3, H, W] to a power of 0.74 to 1.35, mostly 0.8 to 1.2."""
    shape = (len(maps), 1, 1, 1)
    power = torch.exp((0.2 * draw_normal(rng, *shape)).clamp(-0.3, 0.3))
    return maps ** torch.where(draw_uniform(rng, *shape) < REGRADED_SHARE, power, 1.0)


def mix_maps(maps: Tensor, rng: Generator) -> Tensor:
    """Mix some of the maps [T, 3, H, W] with the map before them, in any proportion."""
    shape = (len(maps), 1, 1, 1)
    share = draw_uniform(rng, *shape)
    return torch.lerp(maps.roll(1, 0), maps, torch.where(draw_uniform(rng, *shape) < MIXED_SHARE, share, 1.0))


def add_lamps(maps: Tensor, rng: Generator) -> Tensor:
    """Add lamps of about a texel to some of the maps [T, 3, H, W], anywhere, of radiance 1 to exp(MAX_LOG_RADIANCE)."""
    count, _, height, width = maps.shape

    rows = relu(
        1 - (torch.arange(height, device=rng.device) - (height - 1) * draw_uniform(rng, count, LAMP_COUNT, 1)).abs()
    )
    column_distances = (torch.arange(width, device=rng.device) - width * draw_uniform(rng, count, LAMP_COUNT, 1)).abs()
    columns = relu(1 - torch.minimum(column_distances, width - column_distances))  # around the horizon
    radiance = torch.exp(MAX_LOG_RADIANCE * draw_uniform(rng, count, LAMP_COUNT, 1)) * (
        0.7 + 0.6 * draw_uniform(rng, count, LAMP_COUNT, 3)
    )
    lamps = torch.einsum("tlh,tlw,tlc->tchw", rows, columns, radiance)
    return maps + torch.where(draw_uniform(rng, count, 1, 1, 1) < LAMPS_SHARE, lamps, 0.0)
