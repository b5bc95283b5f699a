"""Surfaces under many lamps, of which everything is known."""

import math

import torch
from torch import Tensor

from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.distant_lamps import render_lit
from metapp.appearance.svbrdf_maps import Maps, pack_maps
from metapp.learning.task import Task


def dome(count: int, lowest_degrees: float = 15.0) -> Tensor:
    """Return unit vectors [count, 3] towards lamps all around."""
    lowest = math.sin(math.radians(lowest_degrees))
    z = lowest + (1 - lowest) * (torch.arange(count) + 0.5) / count
    turn, sine = torch.arange(count) * 2.4, (1 - z * z).sqrt()
    return torch.stack([sine * turn.cos(), sine * turn.sin(), z], 1)


def wavy_maps(side: int, specular: float = 0.0, roughness: float = 0.5) -> Maps:
    """Return maps [C, side, side] of a coloured surface with waves of up to 17 degrees."""
    row, column = torch.meshgrid(torch.linspace(0, 6, side), torch.linspace(0, 6, side), indexing="ij")
    normal = torch.stack([-0.3 * column.sin(), 0.3 * row.cos(), torch.ones_like(row)])
    diffuse = torch.stack([0.3 + 0.2 * row.sin(), 0.4 + 0 * row, 0.5 + 0.2 * column.cos()])
    full = torch.ones(1, side, side)
    return Maps(
        diffuse, specular * full.expand(3, -1, -1), roughness * full, torch.nn.functional.normalize(normal, dim=0)
    )


def photograph(maps: Maps, lamps: Tensor) -> Tensor:
    """Return photographs, sRGB uint8 [N, 3, H, W], without shadows or noise."""
    texels = Maps(*(part[None].flatten(2)[..., None] for part in maps))
    linear = render_lit(texels, lamps[None])[0].unflatten(-1, maps.normal.shape[-2:])
    return (linear_to_srgb(linear.clamp(0, 1)) * 255).round().to(torch.uint8)


def lit_task(side: int = 16, lamps: int = 20, specular: float = 0.0, name: str = "waves") -> Task:
    """Return a task of photographs of a wavy surface under many lamps, with its maps."""
    maps, directions = wavy_maps(side, specular), dome(lamps)
    photos = photograph(maps, directions)
    data = {"photo": photos.float().mean(0).to(torch.uint8), "lit": photos, "lamps": directions}
    return Task(name, data | {"maps": pack_maps(maps).half()})
