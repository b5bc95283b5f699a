"""Height fields of flat materials: normals of heights, and heights by integration of normals.

Heights are in texels, up out of the patch; rows go down, y goes up.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

LEAST_NORMAL_Z = 0.05  # least z of normals that heights follow: slopes stay below 20


def normal_from_height(height: Tensor, scale: Tensor | float = 1.0, *, periodic: bool = True) -> Tensor:
    """Compute normals [B, 3, H, W], z > 0, of a height field, by Scharr's central differences (2000), nearly isotropic.

    A height that alternates from texel to texel gives no slope.

    Args:
        height: [B, 1, H, W], in texels, up out of the patch; H and W at least 2.
        scale: multiplies the height; a number or [B, 1, 1, 1].
        periodic: whether the field tiles; otherwise slopes are extrapolated at edges.
    """
    wide = _pad_field(_pad_field(height, -1, periodic), -2, periodic)
    along_x = wide[..., 2:] - wide[..., :-2]
    along_y = wide[..., :-2, :] - wide[..., 2:, :]  # rows go down, y goes up
    slope_x = (3 * along_x[..., :-2, :] + 10 * along_x[..., 1:-1, :] + 3 * along_x[..., 2:, :]) * (scale / 32)
    slope_y = (3 * along_y[..., :-2] + 10 * along_y[..., 1:-1] + 3 * along_y[..., 2:]) * (scale / 32)
    z = (1 + slope_x * slope_x + slope_y * slope_y).rsqrt()
    return torch.cat([-slope_x * z, -slope_y * z, z], dim=-3)


def _pad_field(field: Tensor, axis: int, periodic: bool) -> Tensor:
    """Pad a field by a texel at either end of an axis: periodically, or by linear extrapolation."""
    first, last, count = field.narrow(axis, 0, 1), field.narrow(axis, -1, 1), field.shape[axis]
    if periodic:
        return torch.cat([last, field, first], dim=axis)
    second, last_but_one = field.narrow(axis, 1, 1), field.narrow(axis, count - 2, 1)
    return torch.cat([2 * first - second, field, 2 * last - last_but_one], dim=axis)


def height_from_normal(normal: Tensor, *, periodic: bool) -> Tensor:
    """Integrate normals to a height field [..., 1, H, W] in texels, of mean 0; its slopes fit theirs in least squares.

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
        along_x = _mirror_slopes(along_x, -1)
        along_row = _mirror_slopes(along_row, -2)
    rows, columns = along_x.shape[-2:]
    across, down = _angular_frequencies(columns, normal)[None, :], _angular_frequencies(rows, normal)[:, None]
    squared = across.square() + down.square()
    # in place: each spectrum of 2048 x 2048 texels, mirrored, takes 0.3 GB
    spectrum = torch.fft.fft2(along_x).mul_(across)
    spectrum += torch.fft.fft2(along_row).mul_(down)
    spectrum.mul_(-1j).div_(squared.clamp_min(1e-12))  # where both frequencies are 0, the sum is 0, too
    padded_height: Tensor = torch.fft.ifft2(spectrum).real
    height = padded_height[..., : normal.shape[-2], : normal.shape[-1]]
    return (height - height.mean((-2, -1), keepdim=True)).to(normal)[..., None, :, :]


def _angular_frequencies(count: int, like: Tensor) -> Tensor:
    """Return angular frequencies in rad per texel, [count]; the highest one of an even count is stated as 0."""
    frequencies: Tensor = 2 * math.pi * torch.fft.fftfreq(count, dtype=torch.float64, device=like.device)
    if count % 2 == 0:  # a wave that alternates from texel to texel has no derivative
        frequencies[count // 2] = 0
    return frequencies


def _mirror_slopes(slopes: Tensor, odd: int) -> Tensor:
    """Mirror a field's slopes at its lower and right edges; the sign of slopes along the axis `odd` changes."""
    for axis in (-1, -2):
        slopes = torch.cat([slopes, slopes.flip(axis) * (-1 if axis == odd else 1)], axis)
    return slopes
