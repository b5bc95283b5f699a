"""Ambient occlusion of height fields, computed in closed form from horizons.

Heights are in texels and point up, out of the patch; row 0 is the upper edge. Leading axes are free.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, interpolate

OCCLUSION_AZIMUTHS = 16  # directions in which horizons are searched
OCCLUSION_RADIUS_WIDTHS = 0.125  # how far the horizon is searched, in widths of the field
MAX_OCCLUSION_SIDE_TEXELS = 512  # of the field that occlusion is computed of: time grows with the third power


def occlusion_from_height(height: Tensor, *, periodic: bool, reach: float = OCCLUSION_RADIUS_WIDTHS) -> Tensor:
    """Return the ambient occlusion of a height field: the share of a uniform sky's light that arrives; 1 is open.

    Horizon-based (Max 1988; Bavoil et al. 2008): in each of OCCLUSION_AZIMUTHS directions the highest elevation a
    within reach is found; the sky above it gives cos(a)^2 of the light that falls on a horizontal texel. A slope's own
    tilt does not count: texels lie flat. Fields larger than MAX_OCCLUSION_SIDE_TEXELS are downsampled, and their
    occlusion is interpolated.

    Args:
        height: the height field, [..., 1, H, W] in texels.
        periodic: whether the field tiles; otherwise the heights at its edges continue outwards.
        reach: how far horizons are searched, in widths of the field.

    Returns:
        The occlusion, [..., 1, H, W] in [0, 1].
    """
    size = height.shape[-2:]
    downsampling = max(size) / MAX_OCCLUSION_SIDE_TEXELS
    if downsampling > 1:
        coarse_size = [max(1, round(side / downsampling)) for side in size]
        pooled = interpolate(height.reshape(-1, 1, *size), size=coarse_size, mode="area") / downsampling
        occlusion = occlusion_from_height(pooled, periodic=periodic, reach=reach)
        return _enlarge(occlusion, size, periodic).reshape(height.shape)
    farthest_texels = max(1, round(reach * height.shape[-1]))
    padded, margin = _widen(height, farthest_texels + 1, periodic), farthest_texels + 1

    def shift_field(down: float, across: float) -> Tensor:
        """Return the field sampled so many rows below and columns to the right, interpolated between texels."""
        field = padded
        for axis, offset in ((-2, down), (-1, across)):
            near = field.narrow(axis, margin + math.floor(offset), size[axis])
            far = field.narrow(axis, margin + math.floor(offset) + 1, size[axis])
            field = torch.lerp(near, far, offset - math.floor(offset))
        return field

    visible_sum = torch.zeros_like(height)
    for i in range(OCCLUSION_AZIMUTHS):
        azimuth = 2 * math.pi * i / OCCLUSION_AZIMUTHS
        steepest_slope = torch.zeros_like(height)
        for distance in _sample_distances(farthest_texels):
            horizon_heights = shift_field(distance * math.sin(azimuth), distance * math.cos(azimuth))
            steepest_slope = torch.maximum(steepest_slope, (horizon_heights - height) / distance)
        visible_sum += 1 / (1 + steepest_slope * steepest_slope)
    return visible_sum / OCCLUSION_AZIMUTHS


def _enlarge(field: Tensor, size: tuple[int, ...], periodic: bool) -> Tensor:
    """Resize a field [B, 1, h, w], interpolated between its texels, and across its edges if it tiles."""
    padded = _widen(field, 1, periodic)
    down, across = (
        2 * ((torch.arange(count, dtype=field.dtype, device=field.device) + 0.5) * side / count + 0.5) / (side + 1) - 1
        for count, side in zip(size, field.shape[-2:], strict=True)
    )
    sample_places = torch.stack(torch.meshgrid(across, down, indexing="xy"), -1)
    return grid_sample(padded, sample_places.expand(len(field), -1, -1, -1), align_corners=True)


def _sample_distances(farthest: int) -> list[int]:
    """Return the distances, in texels, at which heights are read: each texel at first, then in steps of an eighth."""
    distances = [1]
    while distances[-1] < farthest:
        distances.append(min(farthest, max(distances[-1] + 1, math.floor(distances[-1] * 1.125))))
    return distances


def _widen(field: Tensor, margin: int, periodic: bool) -> Tensor:
    """Pad a field [..., H, W] by a margin on each side: by its opposite side if it tiles, else by its edges."""
    for axis in (-2, -1):
        size = field.shape[axis]
        indices = torch.arange(-margin, size + margin, device=field.device)
        field = field.index_select(axis, indices % size if periodic else indices.clamp(0, size - 1))
    return field
