"""The height of a surface over the plane by which photographs of it are registered.

A flash beside the lens shades relief such that its features seem to lie nearer to the camera than they do: by them, all
photographs are registered on a plane below the surface. Photometric stereo explains them best on it.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, grid_sample

from metapp.appearance.flash import texel_positions
from metapp.apps.svbrdf_nonstationary.several.encoder import read_photos

MIN_PX, MIN_PHOTOS = 128, 4  # smaller or fewer photographs do not show the height
MAX_STEPS = 8  # Gauss-Newton steps of the height
MIN_DEVIATIONS = 18.0  # the first step over its standard deviation; photographs stay as they are below it
MIN_TEXELS, MAX_TEXELS = 0.5, 4.0  # heights outside this range are noise or mistakes
RESIDUAL_SCALE = 0.1  # relative deviation of a pixel from a Lambertian texel that halves its weight
RIDGE = 1e-3  # added to the diagonal of normal equations of slopes
EDGE_TEXELS = 4  # texels at each edge that do not count
BLOCKS = 16  # blocks a side, whose scatter gives the standard deviation of a step


@torch.no_grad()
def align_to_surface(photos: Tensor, places: Tensor) -> Tensor:
    """Move photographs from the plane by which they are registered onto the surface.

    Args:
        photos: linear photographs [N, 3, H, W].
        places: positions of camera and flash, [N, 2, 3], in half sides of the patch.

    Returns:
        The photographs, [N, 3, H, W]; the first one stays, and all stay where the height is not significant.
    """
    height, result = photos.new_zeros(()), photos
    if min(photos.shape[-2:]) < MIN_PX or len(photos) < MIN_PHOTOS:
        return photos
    for step in range(MAX_STEPS):
        change, deviation = _find_height_change(result, places)
        if not step and not change > MIN_DEVIATIONS * deviation:
            return photos
        height = height + change
        result = _shift_plane(photos, places[:, 0], height)
    return result if MIN_TEXELS < height * photos.shape[-1] / 2 < MAX_TEXELS else photos


def _shift_plane(photos: Tensor, eyes: Tensor, height: Tensor) -> Tensor:
    """Project photographs [N, 3, H, W] onto a plane of another height, such that the first does not move."""
    scale, shift = eyes[:, 2:] / (eyes[:, 2:] - height), -height * eyes[:, :2] / (eyes[:, 2:] - height)
    scale = scale / scale[:1]
    shift = shift - scale * shift[:1]
    texels = texel_positions(*photos.shape[-2:], dtype=photos.dtype, device=photos.device)[:2]
    grid = (scale[..., None, None] * texels + shift[..., None, None]) * texels.new_tensor([1, -1])[:, None, None]
    shifted = grid_sample(photos, grid.permute(0, 2, 3, 1), "bicubic", "border", align_corners=False)
    return torch.cat([photos[:1], shifted[1:].clamp(0, 1)])


def _find_height_change(photos: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
    """Return a Gauss-Newton step of the height and its standard deviation; brightness and slopes are eliminated."""
    reading = read_photos(photos[None], places[None])
    grey, tangents, weight = (part[0] for part in (reading.grey, reading.tangents, reading.weights))
    x, y = texel_positions(*photos.shape[-2:], dtype=photos.dtype, device=photos.device)[:2]
    eyes = places[:, 0, :, None, None]
    down, right = torch.gradient(grey[:, 0], spacing=2 / photos.shape[-1], dim=(-2, -1))
    height_derivative = (right * (x - eyes[:, 0]) - down * (y - eyes[:, 1])) / eyes[:, 2]
    sides = torch.stack([grey[:, 0], height_derivative], -1) / reading.level[0, 0, :, :, None]
    rows = torch.cat([torch.ones_like(grey), tangents], 1)
    weight = weight[:, 0] / (sides[..., 0] + 0.05).square()
    matrix = torch.einsum("nihw,njhw,nhw->hwij", rows, rows, weight) + torch.diag(rows.new_tensor([1e-6, RIDGE, RIDGE]))
    solution = torch.linalg.solve(matrix, torch.einsum("nihw,nhw,nhwk->hwik", rows, weight, sides))
    residual, sensitivity = (sides - torch.einsum("nihw,hwik->nhwk", rows, solution)).unbind(-1)
    weight = weight / (1 + (residual / RESIDUAL_SCALE).square())
    products = [
        (weight * sensitivity * factor).sum(0)[EDGE_TEXELS:-EDGE_TEXELS, EDGE_TEXELS:-EDGE_TEXELS]
        for factor in (residual, sensitivity)
    ]
    blocks = adaptive_avg_pool2d(products[0][None], BLOCKS)
    return -products[0].mean() / products[1].mean(), blocks.std() / BLOCKS / products[1].mean()
