"""The height of a surface over the plane by which photographs of it are registered.

A flash beside the lens shades relief such that its features seem to lie nearer to the camera than they do: by them, all
photographs are registered on a plane below the surface. Photometric stereo explains them best on it.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, grid_sample

from metapp.appearance.flash import positions
from metapp.apps.svbrdf_nonstationary.several.encoder import read

FINEST_PX, FEWEST = 128, 4  # coarser or fewer photographs do not tell
STEPS, SURE = 8, 18.0  # changes of the height; deviations, of a first change, that it must exceed
LEAST, FARTHEST = 0.5, 4.0  # texels that a height may be off
RESIDUAL, RIDGE, EDGE, BLOCKS = 0.1, 1e-3, 4, 16  # of a texel's level; of slopes; texels; parts of a side


@torch.no_grad()
def levelled(photos: Tensor, places: Tensor) -> Tensor:
    """Photographs [N, 3, H, W], linear, as they are on the surface, from places [N, 2, 3]; the first stays."""
    height, result = photos.new_zeros(()), photos
    if min(photos.shape[-2:]) < FINEST_PX or len(photos) < FEWEST:
        return photos
    for step in range(STEPS):
        change, deviation = _change(result, places)
        if not step and not change > SURE * deviation:
            return photos
        height = height + change
        result = _moved(photos, places[:, 0], height)
    return result if LEAST < height * photos.shape[-1] / 2 < FARTHEST else photos


def _moved(photos: Tensor, eyes: Tensor, height: Tensor) -> Tensor:
    """Photographs on a plane so high, such that the first does not move."""
    scale, shift = eyes[:, 2:] / (eyes[:, 2:] - height), -height * eyes[:, :2] / (eyes[:, 2:] - height)
    scale = scale / scale[:1]
    shift = shift - scale * shift[:1]
    texels = positions(*photos.shape[-2:], dtype=photos.dtype, device=photos.device)[:2]
    at = (scale[..., None, None] * texels + shift[..., None, None]) * texels.new_tensor([1, -1])[:, None, None]
    moved = grid_sample(photos, at.permute(0, 2, 3, 1), "bicubic", "border", align_corners=False)
    return torch.cat([photos[:1], moved[1:].clamp(0, 1)])


def _change(photos: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
    """Gauss-Newton's change of the height after each texel's level and slopes are eliminated, and its deviation."""
    reading = read(photos[None], places[None])
    grey, tangents, weight = (part[0] for part in (reading.grey, reading.tangents, reading.weights))
    x, y = positions(*photos.shape[-2:], dtype=photos.dtype, device=photos.device)[:2]
    eyes = places[:, 0, :, None, None]
    down, right = torch.gradient(grey[:, 0], spacing=2 / photos.shape[-1], dim=(-2, -1))
    along = (right * (x - eyes[:, 0]) - down * (y - eyes[:, 1])) / eyes[:, 2]
    both = torch.stack([grey[:, 0], along], -1) / reading.level[0, 0, :, :, None]
    rows = torch.cat([torch.ones_like(grey), tangents], 1)
    weight = weight[:, 0] / (both[..., 0] + 0.05).square()
    matrix = torch.einsum("nihw,njhw,nhw->hwij", rows, rows, weight) + torch.diag(rows.new_tensor([1e-6, RIDGE, RIDGE]))
    solution = torch.linalg.solve(matrix, torch.einsum("nihw,nhw,nhwk->hwik", rows, weight, both))
    left, moves = (both - torch.einsum("nihw,hwik->nhwk", rows, solution)).unbind(-1)
    weight = weight / (1 + (left / RESIDUAL).square())
    inner = [(weight * moves * each).sum(0)[EDGE:-EDGE, EDGE:-EDGE] for each in (left, moves)]
    blocks = adaptive_avg_pool2d(inner[0][None], BLOCKS)
    return -inner[0].mean() / inner[1].mean(), blocks.std() / BLOCKS / inner[1].mean()
