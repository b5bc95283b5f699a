"""Data augmentation of whole materials: patches of any scale, relief beside other colours, photographed anew."""

from __future__ import annotations

import math

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d

from metapp.apps.svbrdf_nonstationary.maps import INPUTS, inputs_of, of_length_1, pooled
from metapp.apps.svbrdf_nonstationary.pretrained.encoder import patch_of
from metapp.apps.svbrdf_nonstationary.variants import (
    RESTYLED,
    draws_of,
    mixed,
    photographs,
    recoloured,
    restyled,
    some,
    turned_crops,
)
from metapp.learning.task import Batch

LEAST = 0.4  # the side of a photographed patch, of the side of a material's maps
SQUARE = 0.5  # of patches whose sides are those of the maps, which may show all of them
POLISHED, FLATTER = 0.3, (-4.0, -0.7)  # of materials that are nearly flat, and the log of what their slopes are times
WHOLE = 0.4  # the share of outer steps that see all of a patch, half as fine
FINER = 0.5  # the share of outer steps of twice as many texels as pixels: relief within a pixel widens highlights
CROSSED = 0.3  # of materials whose relief is another's, so that colours say nothing of it


def pieces(maps: Tensor, side: int, rng: Generator) -> Tensor:
    """Patches [T, 10, side, side] of maps [T, 10, S, S], from anywhere, in any direction, half of them mirrored."""
    uniform, _ = draws_of(len(maps), rng)
    angle = 2 * math.pi * uniform()
    quarters = (2 * angle / math.pi).round() * math.pi / 2
    angle = torch.where(uniform() < SQUARE, quarters, angle)
    across = angle.cos().abs() + angle.sin().abs()  # of a square of side 1
    extent = torch.lerp(torch.full_like(across, LEAST), 1 / across, uniform())
    while 2 * side <= float(extent.min()) * maps.shape[-1]:  # no finer than what is made of them
        maps = avg_pool2d(maps, 2)
    centre = (1 - extent * across)[:, None] * (2 * uniform(2) - 1)
    return turned_crops(maps, side, angle, extent, centre, uniform(1, 1, 1) < 0.5, "border")


def polished(maps: Tensor, rng: Generator) -> Tensor:
    """Materials [T, 10, S, S] whose patterns are nearly all paint."""
    uniform, _ = draws_of(len(maps), rng)
    low, high = FLATTER
    slopes = maps[:, :2] / maps[:, 2:3].clamp_min(0.2) * torch.exp(low + (high - low) * uniform(1, 1, 1))
    return torch.cat([of_length_1(torch.cat([slopes, torch.ones_like(slopes[:, :1])], 1)), maps[:, 3:]], 1)


def crossed(maps: Tensor, known: Tensor, rng: Generator) -> tuple[Tensor, Tensor]:
    """Materials [T, 10, S, S], some with the normals of the one before, and the weights of these [T, 4]."""
    uniform, _ = draws_of(len(maps), rng)
    chosen = uniform(1, 1, 1) < CROSSED
    normal = torch.where(chosen, maps[:, :3].roll(1, 0), maps[:, :3])
    weight = torch.where(chosen[:, :, 0, 0], known[:, 3:].roll(1, 0), known[:, 3:])
    return torch.cat([normal, maps[:, 3:]], 1), torch.cat([known[:, :3], weight], 1)


def blended(maps: Tensor, known: Tensor, rng: Generator) -> tuple[Tensor, Tensor]:
    """Materials [T, 10, S, S], half of them mixed with the one before, and the weights of both [T, 4]."""
    both = mixed(maps, rng)
    alone = (both[:, 3:] == maps[:, 3:]).flatten(1).all(1, keepdim=True)
    return both, torch.where(alone, known, torch.minimum(known, known.roll(1, 0)))


def variants(fine: Tensor, known: Tensor, side: int, rng: Generator) -> Batch:
    """Augmented materials of maps [T, 10, S, S]: windows of side x side texels of photographs of twice the side.

    Returns:
        `photo` [T, 3, side, side], linear, and `patch_of` of all of the patch; `inputs`, the field's,
        [T, 8, side, side]; `maps` and `known`.
    """
    times = 2 if chance(FINER, rng) else 1
    maps = some(restyled, pieces(fine, times * 2 * side, rng), RESTYLED[0], rng)
    maps, known = blended(recoloured(maps, rng), known, rng)
    maps, known = crossed(some(restyled, maps, RESTYLED[1], rng), known, rng)
    maps = some(polished, maps, POLISHED, rng)
    photo, maps = avg_pool2d(photographs(maps, rng), times), pooled(maps, (2 * side, 2 * side))
    whole = patch_of(photo)
    if chance(WHOLE, rng):
        photo, maps = avg_pool2d(photo, 2), pooled(maps, (side, side))
        inputs = inputs_of(photo)
    else:
        parts = (3, INPUTS, maps.shape[1])
        photo, inputs, maps = windows(torch.cat([photo, inputs_of(photo), maps], 1), side, rng).split(parts, 1)
    return {"photo": photo, "inputs": inputs, "maps": maps, "known": known} | whole


def chance(share: float, rng: Generator) -> bool:
    """True in so large a share of the times."""
    return float(torch.rand(1, generator=rng, device=rng.device)) < share


def windows(pictures: Tensor, side: int, rng: Generator) -> Tensor:
    """Squares [T, C, side, side] of pictures [T, C, S, S], each from anywhere in it."""
    uniform, _ = draws_of(len(pictures), rng)
    corner = (uniform(2) * (pictures.shape[-1] - side + 1)).long().clamp_max(pictures.shape[-1] - side)
    squares = zip(pictures, corner.tolist(), strict=True)
    cut = [each[:, row : row + side, column : column + side] for each, (row, column) in squares]
    return torch.stack(cut)
