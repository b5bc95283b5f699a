"""Height fields of flat materials from their normals.

Heights are in texels and go up, out of the patch; row 0 is the upper edge. Leading axes are free.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

LEAST_NORMAL_Z = 0.05  # least z of normals: slopes stay below 20


def height_from_normal(normal: Tensor, *, periodic: bool) -> Tensor:
    """The height field [..., 1, H, W] in texels, of mean 0, whose slopes fit those of normals in least squares.

    Frankot and Chellappa, "A Method for Enforcing Integrability in Shape from Shading Algorithms" (1988): each
    frequency of the height is the projection of both slopes onto its derivatives; exact for band-limited fields.

    Args:
        normal: [..., 3, H, W], z up out of the patch; z below 0.05 counts as 0.05.
        periodic: whether the field tiles; otherwise it is mirrored at its edges.
    """
    x, y, z = normal.double().unbind(-3)
    z = z.clamp_min(LEAST_NORMAL_Z)
    along_x, along_row = -x / z, y / z  # rows go down, y goes up
    if not periodic:
        along_x = _mirrored(along_x, -1)
        along_row = _mirrored(along_row, -2)
    rows, columns = along_x.shape[-2:]
    across, down = _frequencies(columns, normal)[None, :], _frequencies(rows, normal)[:, None]
    squared = across.square() + down.square()
    spectrum = torch.fft.fft2(along_x).mul_(across)  # in place: 0.3 GB of 2048 x 2048 texels, mirrored
    spectrum += torch.fft.fft2(along_row).mul_(down)
    spectrum.mul_(-1j).div_(squared.clamp_min(1e-12))  # where both are 0, so is the sum
    whole: Tensor = torch.fft.ifft2(spectrum).real
    height = whole[..., : normal.shape[-2], : normal.shape[-1]]
    return (height - height.mean((-2, -1), keepdim=True)).to(normal)[..., None, :, :]


def _frequencies(count: int, like: Tensor) -> Tensor:
    """Radians a texel, [count]; the highest of an even count has no derivative and counts as 0."""
    frequencies: Tensor = 2 * math.pi * torch.fft.fftfreq(count, dtype=torch.float64, device=like.device)
    if count % 2 == 0:
        frequencies[count // 2] = 0
    return frequencies


def _mirrored(slopes: Tensor, odd: int) -> Tensor:
    """Slopes of a field that is mirrored at its lower and right edges: those along the axis `odd` change their sign."""
    for axis in (-1, -2):
        slopes = torch.cat([slopes, slopes.flip(axis) * (-1 if axis == odd else 1)], axis)
    return slopes
