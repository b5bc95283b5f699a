"""Data augmentation of whole materials: windows of any scale, relief beside other colours, photographed anew."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, pad

from metapp.appearance.flash import positions
from metapp.apps.svbrdf_nonstationary.maps import inputs_of
from metapp.apps.svbrdf_nonstationary.variants import (
    RESTYLED,
    draws,
    photographs,
    recoloured,
    restyled,
    some,
    turned_crops,
)
from metapp.learning.task import Batch

PATCH = (0.4, 0.7)  # the side of a photographed patch, of the side of a material's maps
WHOLE = 0.4  # the share of outer steps that see all of a patch, half as fine
CROSSED = 0.3  # of materials whose relief is another's, so that colours say nothing of it


class Window(NamedTuple):
    """A part of a patch that photographs show.

    Attributes:
        share: its side over the patch's.
        place: [T, 2, side, side], where in the patch its texels are.
    """

    share: float
    place: Tensor


def drawn_window(count: int, side: int, rng: Generator) -> Window:
    """A quarter of a patch of 2 side x 2 side texels, anywhere in it; or all of one that is half as fine."""
    uniform, _ = draws(count, rng)
    if float(torch.rand(1, generator=rng, device=rng.device)) < WHOLE:
        return Window(1.0, positions(side, side, device=rng.device).expand(count, -1, -1, -1))
    corner = (uniform(2) * (side + 1)).long().clamp_max(side)
    steps = torch.arange(side, device=rng.device)
    rows, columns = ((corner[:, i : i + 1] + steps) for i in range(2))
    patch = positions(2 * side, 2 * side, device=rng.device)
    x = patch[0, 0][columns][:, None, :].expand(-1, side, -1)
    y = patch[1, :, 0][rows][:, :, None].expand(-1, -1, side)
    return Window(0.5, torch.stack([x, y], 1))


def pieces(maps: Tensor, side: int, share: float, rng: Generator) -> Tensor:
    """Pieces [T, 10, side, side] of maps [T, 10, S, S], from anywhere, in any direction, half of them mirrored.

    Each is a `share` of a patch whose side is a share of the maps' as PATCH says.
    """
    uniform, _ = draws(len(maps), rng)
    extent = share * (PATCH[0] + (PATCH[1] - PATCH[0]) * uniform())
    while 2 * side <= float(extent.min()) * maps.shape[-1]:  # no finer than what is made of them
        maps = avg_pool2d(maps, 2)
    angle = 2 * math.pi * uniform()
    room = 1 - math.sqrt(2) * extent
    centre = room[:, None] * (2 * uniform(2) - 1)
    return turned_crops(maps, side, angle, extent, centre, uniform(1, 1, 1) < 0.5, "border")


def crossed(maps: Tensor, known: Tensor, rng: Generator) -> tuple[Tensor, Tensor]:
    """Materials [T, 10, S, S], some with the normals of the one before, and what is known of these [T, 4]."""
    uniform, _ = draws(len(maps), rng)
    chosen = uniform(1, 1, 1) < CROSSED
    normal = torch.where(chosen, maps[:, :3].roll(1, 0), maps[:, :3])
    weight = torch.where(chosen[:, :, 0, 0], known[:, 3:].roll(1, 0), known[:, 3:])
    return torch.cat([normal, maps[:, 3:]], 1), torch.cat([known[:, :3], weight], 1)


def variants(fine: Tensor, known: Tensor, side: int, rng: Generator) -> Batch:
    """Augmented materials of maps [T, 10, S, S], as windows of side x side texels, photographed.

    Returns:
        `photo` [T, 3, side, side], linear; `inputs`, the field's, [T, 8, side, side]; `maps` and `known`.
    """
    share, place = drawn_window(len(fine), side, rng)
    maps = some(restyled, pieces(fine, side, share, rng), RESTYLED[0], rng)
    maps, known = crossed(some(restyled, recoloured(maps, rng), RESTYLED[1], rng), known, rng)
    photo = photographs(maps, rng, place)
    return {"photo": photo, "inputs": inputs_in(photo, place, share), "maps": maps, "known": known}


def inputs_in(photo: Tensor, place: Tensor, share: float) -> Tensor:
    """The field's inputs in a window [T, 3, side, side], as `inputs_of` has them in a photograph of the whole patch."""
    side = photo.shape[-1]
    margin = round(side / share - side) // 2
    inputs = inputs_of(pad(photo, (margin,) * 4, mode="replicate"))[..., margin : margin + side, margin : margin + side]
    return torch.cat([inputs[:, :-2], place], 1)
