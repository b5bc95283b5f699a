"""Ambient occlusion of height fields in closed form.

Heights are in texels and go up, out of the patch; row 0 is the upper edge. Leading axes are free.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, interpolate

OCCLUSION_AZIMUTHS = 16
OCCLUSION_RADIUS_WIDTHS = 0.125  # of the width: radius of occlusion
MAX_OCCLUSION_SIDE_TEXELS = 512  # texels a side at which occlusion is computed: its time grows by the third power


def occlusion_from_height(height: Tensor, *, periodic: bool, reach: float = OCCLUSION_RADIUS_WIDTHS) -> Tensor:
    """Ambient occlusion [..., 1, H, W] in [0, 1] of a height field: the share of a uniform sky's light; 1 is open.

    Horizon-based (Max 1988; Bavoil et al. 2008): in AZIMUTHS directions the highest elevation a within reach; the sky
    above gives cos(a)^2 of the light that falls on a horizontal texel. A slope's own tilt does not count: texels lie
    flat. Fields larger than FINEST are downsampled, and their occlusion is interpolated.

    Args:
        height: [..., 1, H, W] in texels.
        periodic: whether the field tiles; otherwise its edges go on at their height.
        reach: radius, in widths.
    """
    size = height.shape[-2:]
    coarser = max(size) / MAX_OCCLUSION_SIDE_TEXELS
    if coarser > 1:
        few = [max(1, round(side / coarser)) for side in size]
        pooled = interpolate(height.reshape(-1, 1, *size), size=few, mode="area") / coarser
        occlusion = occlusion_from_height(pooled, periodic=periodic, reach=reach)
        return _enlarged(occlusion, size, periodic).reshape(height.shape)
    farthest = max(1, round(reach * height.shape[-1]))
    wide, margin = _widened(height, farthest + 1, periodic), farthest + 1

    def shifted(down: float, across: float) -> Tensor:
        """The field sampled so many rows below and columns to the right, interpolated between texels."""
        field = wide
        for axis, offset in ((-2, down), (-1, across)):
            near = field.narrow(axis, margin + math.floor(offset), size[axis])
            far = field.narrow(axis, margin + math.floor(offset) + 1, size[axis])
            field = torch.lerp(near, far, offset - math.floor(offset))
        return field

    total = torch.zeros_like(height)
    for i in range(OCCLUSION_AZIMUTHS):
        turn = 2 * math.pi * i / OCCLUSION_AZIMUTHS
        slope = torch.zeros_like(height)
        for distance in _distances(farthest):
            there = shifted(distance * math.sin(turn), distance * math.cos(turn))
            slope = torch.maximum(slope, (there - height) / distance)
        total += 1 / (1 + slope * slope)
    return total / OCCLUSION_AZIMUTHS


def _enlarged(field: Tensor, size: tuple[int, ...], periodic: bool) -> Tensor:
    """A field [B, 1, h, w] at another size, interpolated between its texels, across its edges if it tiles."""
    wide = _widened(field, 1, periodic)
    down, across = (
        2 * ((torch.arange(count, dtype=field.dtype, device=field.device) + 0.5) * few / count + 0.5) / (few + 1) - 1
        for count, few in zip(size, field.shape[-2:], strict=True)
    )
    places = torch.stack(torch.meshgrid(across, down, indexing="xy"), -1)
    return grid_sample(wide, places.expand(len(field), -1, -1, -1), align_corners=True)


def _distances(farthest: int) -> list[int]:
    """Every texel at first, then in steps of an eighth of the distance."""
    distances = [1]
    while distances[-1] < farthest:
        distances.append(min(farthest, max(distances[-1] + 1, math.floor(distances[-1] * 1.125))))
    return distances


def _widened(field: Tensor, margin: int, periodic: bool) -> Tensor:
    """A field [..., H, W] with a margin on each side: its other side if it tiles, else its edges."""
    for axis in (-2, -1):
        size = field.shape[axis]
        places = torch.arange(-margin, size + margin, device=field.device)
        field = field.index_select(axis, places % size if periodic else places.clamp(0, size - 1))
    return field
