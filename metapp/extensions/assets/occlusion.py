"""Ambient occlusion of height fields in closed form.

Heights are in texels and go up, out of the patch; row 0 is the upper edge. Leading axes are free.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, interpolate, pad

AZIMUTHS = 16
REACH = 0.125  # of the width: radius of occlusion
FINEST = 512  # texels a side at which occlusion is computed: its time grows by the third power


def occlusion_from_height(height: Tensor, *, periodic: bool, reach: float = REACH) -> Tensor:
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
    coarser = max(size) / FINEST
    if coarser > 1:
        few = [max(1, round(side / coarser)) for side in size]
        pooled = interpolate(height.reshape(-1, 1, *size), size=few, mode="area") / coarser
        occlusion = occlusion_from_height(pooled, periodic=periodic, reach=reach)
        return _enlarged(occlusion, size, periodic).reshape(height.shape)
    farthest = max(1, round(reach * height.shape[-1]))
    total = torch.zeros_like(height)
    for i in range(AZIMUTHS):
        turn = 2 * math.pi * i / AZIMUTHS
        slope = torch.zeros_like(height)
        for distance in _distances(farthest):
            there = _shifted(height, distance * math.cos(turn), distance * math.sin(turn), periodic)
            slope = torch.maximum(slope, (there - height) / distance)
        total += 1 / (1 + slope * slope)
    return total / AZIMUTHS


def _enlarged(field: Tensor, size: tuple[int, ...], periodic: bool) -> Tensor:
    """A field [B, 1, h, w] at another size, interpolated between its texels, across its edges where it tiles."""
    wide = pad(field, (1, 1, 1, 1), mode="circular" if periodic else "replicate")
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


def _shifted(field: Tensor, x: float, rows: float, periodic: bool) -> Tensor:
    """A field [..., H, W] sampled x columns to the right and so many rows below, interpolated between texels."""
    for offset, axis in ((x, -1), (rows, -2)):
        whole = math.floor(offset)
        share = offset - whole
        near = _moved(field, whole, axis, periodic)
        field = near if share < 1e-9 else torch.lerp(near, _moved(field, whole + 1, axis, periodic), share)
    return field


def _moved(field: Tensor, count: int, axis: int, periodic: bool) -> Tensor:
    if periodic:
        return field.roll(-count, axis)
    size = field.shape[axis]
    rows = (torch.arange(size, device=field.device) + count).clamp(0, size - 1)
    return field.index_select(axis, rows)
