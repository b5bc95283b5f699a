"""Photographs moved by texels and less, such that all show each point of a surface at the same texel.

Features by which photographs are registered are made by relief as much as by colours, and shading moves them. A flash
beside the lens shades relief such that its features seem to lie nearer to the camera than they do: by them, all
photographs are registered on a plane below the surface. What is left differs from photograph to photograph, as
features do. Photographs that are aligned are those that photometric stereo explains best. So their displacements are
found by Gauss-Newton steps, as in direct image alignment (Lucas and Kanade 1981), where stereo predicts each photograph
by the others.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, grid_sample

from metapp.appearance.flash import texel_positions
from metapp.apps.svbrdf_nonstationary.several.encoder import read_photos

MIN_PX, MIN_PHOTOS = 128, 4  # smaller or fewer photographs do not show displacements
HEIGHT_STEPS, SHIFT_STEPS = 8, 3  # Gauss-Newton steps of the height, and of the shifts
# The first step over its standard deviation; photographs stay as they are below it.
MIN_HEIGHT_DEVIATIONS, MIN_SHIFT_DEVIATIONS = 18.0, 5.0
MIN_HEIGHT_TEXELS, MAX_HEIGHT_TEXELS = 0.5, 4.0  # heights outside this range are noise or mistakes
MAX_SHIFT_TEXELS = 2.0  # larger shifts are mistakes
# Photographs are moved only where stereo explains them better afterwards: its robust squared residual must fall below
# this share of the one before. Bark, held by hand: 0.91. Photographs at exact places: 0.96 to 1.06.
MAX_RESIDUAL_SHARE = 0.95
RESIDUAL_SCALE = 0.1  # relative deviation of a pixel from a Lambertian texel that halves its weight
RIDGE = 1e-3  # added to the diagonal of normal equations of slopes
EDGE_TEXELS = 4  # texels at each edge that do not count
_INNER = ..., slice(EDGE_TEXELS, -EDGE_TEXELS), slice(EDGE_TEXELS, -EDGE_TEXELS)
BLOCKS = 16  # blocks a side, whose scatter gives the standard deviation of a step


class _Explanation(NamedTuple):
    """Lambertian texels that explain N photographs.

    Attributes:
        grey: brightness over the brightness of a flat white patch, [N, H, W].
        level: brightness of texels that face the flash, [H, W].
        weight: weights of the photographs' brightness over the level, [N, H, W].
        prediction: by how much stereo's prediction of a photograph grows with the brightness over the level of each
            photograph, [N, N, H, W]; the first axis is of the predicted photograph.
        residual: brightness over the level minus its prediction, [N, H, W].
    """

    grey: Tensor
    level: Tensor
    weight: Tensor
    prediction: Tensor
    residual: Tensor


@torch.no_grad()
def align_photos(photos: Tensor, places: Tensor) -> Tensor:
    """Move photographs from the plane by which they are registered onto the surface, and then shift each of them.

    Args:
        photos: linear photographs [N, 3, H, W].
        places: positions of camera and flash, [N, 2, 3], in half sides of the patch.

    Returns:
        The photographs, [N, 3, H, W]; the first one stays, and all stay where no displacement is significant.
    """
    if min(photos.shape[-2:]) < MIN_PX or len(photos) < MIN_PHOTOS:
        return photos
    return _shift_photos(_move_to_surface(photos, places), places)


def _move_to_surface(photos: Tensor, places: Tensor) -> Tensor:
    """Project photographs [N, 3, H, W] onto a plane at the height of the surface, if it is significant."""
    texels, eyes = _texels_of(photos), places[:, 0, :, None, None]
    # By how much the surface moves in each photograph as its height grows, [1, N, 2, H, W]
    rates = ((texels - eyes[:, :2]) / eyes[:, 2:])[None]
    height, result = photos.new_zeros(()), photos
    for step in range(HEIGHT_STEPS):
        change, covariance = _find_displacements(result, places, rates)
        if not step and not change > MIN_HEIGHT_DEVIATIONS * covariance[0].sqrt():
            return photos
        height = height + change[0]
        result = _shift_plane(photos, places[:, 0], height)
    is_possible = MIN_HEIGHT_TEXELS < height * photos.shape[-1] / 2 < MAX_HEIGHT_TEXELS
    return result if is_possible and _is_better(result, photos, places) else photos


def _shift_photos(photos: Tensor, places: Tensor) -> Tensor:
    """Shift each of the photographs [N, 3, H, W] but the first, if any of the shifts is significant."""
    texels, others = _texels_of(photos), len(photos) - 1
    axes = torch.eye(2).to(photos)[:, :, None, None].expand(-1, -1, *photos.shape[-2:])
    rates = photos.new_zeros(others, 2, len(photos), 2, *photos.shape[-2:])
    for number in range(others):
        rates[number, :, number + 1] = axes
    shifts, result = photos.new_zeros(others, 2), photos
    for step in range(SHIFT_STEPS):
        change, covariance = _find_displacements(result, places, rates.flatten(0, 1))
        changes, deviations = change.view(others, 2), covariance.diag().view(others, 2).sum(1).sqrt()
        if not step and not (changes.norm(dim=1) > MIN_SHIFT_DEVIATIONS * deviations).any():
            return photos
        shifts = shifts + changes
        result = _resample(photos, texels + torch.cat([shifts.new_zeros(1, 2), shifts])[:, :, None, None])
    is_possible = shifts.norm(dim=1).max() * photos.shape[-1] / 2 < MAX_SHIFT_TEXELS
    return result if is_possible and _is_better(result, photos, places) else photos


def _texels_of(photos: Tensor) -> Tensor:
    """Return the positions of the texels of photographs [N, 3, H, W], [2, H, W]."""
    return texel_positions(*photos.shape[-2:], dtype=photos.dtype, device=photos.device)


def _shift_plane(photos: Tensor, eyes: Tensor, height: Tensor) -> Tensor:
    """Project photographs [N, 3, H, W] onto a plane of another height, such that the first does not move."""
    scale, shift = eyes[:, 2:] / (eyes[:, 2:] - height), -height * eyes[:, :2] / (eyes[:, 2:] - height)
    scale = scale / scale[:1]
    shift = shift - scale * shift[:1]
    return _resample(photos, scale[..., None, None] * _texels_of(photos) + shift[..., None, None])


def _resample(photos: Tensor, positions: Tensor) -> Tensor:
    """Read photographs [N, 3, H, W], but the first, at other positions [N, 2, H, W], x right and y up."""
    grid = positions * positions.new_tensor([1, -1])[:, None, None]
    resampled = grid_sample(photos, grid.permute(0, 2, 3, 1), "bicubic", "border", align_corners=False)
    return torch.cat([photos[:1], resampled[1:].clamp(0, 1)])


def _is_better(moved: Tensor, photos: Tensor, places: Tensor) -> bool:
    """Test whether stereo explains moved photographs better, by MAX_RESIDUAL_SHARE, than photographs [N, 3, H, W]."""
    residuals = []
    for compared in (moved, photos):
        squared = _explain(compared, places).residual[_INNER].square()
        residuals.append((squared / (squared + RESIDUAL_SCALE**2)).mean())
    return bool(residuals[0] < MAX_RESIDUAL_SHARE * residuals[1])


def _explain(photos: Tensor, places: Tensor) -> _Explanation:
    """Explain photographs [N, 3, H, W] by the brightness and slopes of Lambertian texels."""
    reading = read_photos(photos[None], places[None])
    grey, tangents, weight = (part[0] for part in (reading.grey, reading.tangents, reading.weights))
    level = reading.level[0, 0]
    brightness = grey[:, 0] / level
    rows = torch.cat([torch.ones_like(grey), tangents], 1)
    weight = weight[:, 0] / (brightness + 0.05).square()
    matrix = torch.einsum("nihw,njhw,nhw->hwij", rows, rows, weight) + torch.diag(rows.new_tensor([1e-6, RIDGE, RIDGE]))
    prediction = torch.einsum("nihw,hwij,mjhw,mhw->nmhw", rows, torch.linalg.inv(matrix), rows, weight)
    residual = brightness - torch.einsum("nmhw,mhw->nhw", prediction, brightness)
    return _Explanation(grey[:, 0], level, weight, prediction, residual)


def _find_displacements(photos: Tensor, places: Tensor, rates: Tensor) -> tuple[Tensor, Tensor]:
    """Return a Gauss-Newton step of the numbers of displacements; brightness and slopes of texels are eliminated.

    Args:
        photos: linear photographs [N, 3, H, W].
        places: positions of camera and flash, [N, 2, 3], in half sides of the patch.
        rates: for K numbers by how much photographs show a texel elsewhere as the number grows, [K, N, 2, H, W].

    Returns:
        The step, [K], and its covariance, [K, K], from the scatter between blocks of texels.
    """
    grey, level, weight, prediction, residual = _explain(photos, places)
    down, right = torch.gradient(grey, spacing=2 / photos.shape[-1], dim=(-2, -1))
    sensitivities = (right * rates[:, :, 0] - down * rates[:, :, 1]) / level
    sensitivities = sensitivities - torch.einsum("nmhw,kmhw->knhw", prediction, sensitivities)
    weight = weight / (1 + (residual / RESIDUAL_SCALE).square())
    sensitivities, weighted = sensitivities[_INNER], (weight * sensitivities)[_INNER]
    products = (weighted * residual[_INNER]).sum(1)
    inverse = torch.linalg.inv(torch.einsum("knhw,lnhw->kl", weighted, sensitivities).double())
    change = -inverse @ products.sum((1, 2)).double()
    blocks = adaptive_avg_pool2d(products, BLOCKS).flatten(1).double() * (products[0].numel() / BLOCKS**2)
    blocks = blocks - blocks.mean(1, keepdim=True)
    return change.to(photos), (inverse @ (blocks @ blocks.mT) @ inverse).to(photos)
