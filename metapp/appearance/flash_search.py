"""The search for the point below the flash in a photograph of a flat material.

The highlight shows it; without one, the fall-off of brightness does.
"""

from __future__ import annotations

import functools

import torch
from torch import Tensor

from metapp.appearance.colour import DISPLAY_GAMMA
from metapp.appearance.flash import texel_positions

FARTHEST_FLASH_HALF_SIDES = 0.5  # distance from a photo's centre within which its flash is searched for


def estimate_flash_position(photo: Tensor) -> Tensor:
    """Estimate the point of the patch below the flash from a photo's highlight, or without one from its fall-off.

    Put both light and view above that point: an off-centre highlight mostly means a camera that was not held straight.

    Args:
        photo: [B, 3, H, W] or [3, H, W] as displayed (gamma-encoded), in [0, 1]; 16 pixels or more a side.

    Returns:
        [B, 2] in half sides, x right and y up, at most 0.5 from the centre, and near it where the photo is ambiguous.
        Errors on renders: 0.03, 0.1 under strong texture, 0.3 where that is coarse and matte. Without useful gradients.
    """
    height, width = photo.shape[-2:]
    cell = min(height, width) / min(32, height, width)
    luminance = photo.mean(-3, keepdim=True)

    def pool(picture: Tensor) -> Tensor:
        size = round(height / cell), round(width / cell)
        return torch.nn.functional.adaptive_avg_pool2d(picture, size).squeeze(-3)

    highlight, is_clear = _find_highlight(pool(luminance**DISPLAY_GAMMA))
    return torch.where(is_clear, highlight, _find_falloff_centre((pool(luminance) + 1 / 255).log()))


def _find_highlight(radiance: Tensor) -> tuple[Tensor, Tensor]:
    """Find the centre of the bright outliers among cells [B, rows, columns], and whether they are one central spot.

    Returns:
        The centre [B, 2] in half sides, and bool [B, 1].
    """
    positions = texel_positions(*radiance.shape[-2:], dtype=radiance.dtype, device=radiance.device).flatten(1).T
    cells = radiance.flatten(-2)
    deviations = cells - cells.median(-1, keepdim=True).values
    # 1.4826: the ratio for a normal distribution
    standard_deviation = 1.4826 * deviations.abs().median(-1, keepdim=True).values + 1e-3
    # Neither the fall-off on a matte material nor most textures reach six deviations.
    weights = (deviations / standard_deviation - 6).clamp_min(0)
    total = weights.sum(-1, keepdim=True)
    normalized_weights = weights / total.clamp_min(1e-6)
    centre = normalized_weights @ positions
    spread_squared = normalized_weights @ positions.square().sum(-1, keepdim=True) - centre.square().sum(
        -1, keepdim=True
    )
    is_near = centre.square().sum(-1, keepdim=True) < FARTHEST_FLASH_HALF_SIDES**2
    return centre, is_near & (total > 3) & (spread_squared < 0.35**2)


def _find_falloff_centre(brightness: Tensor) -> Tensor:
    """Estimate the centre [B, 2] of the radial fall-off of log brightness [B, rows, columns].

    It is the mean of a posterior over centres: the likelihood counts 40 cells as independent (texture correlates the
    errors of neighbours), and the prior, 0.2 wide, decides where nothing is radial.
    """
    centres, basis, falls = (part.to(brightness) for part in _radial_models(*brightness.shape[-2:]))
    cells = brightness.flatten(-2)
    cells = cells - cells.mean(-1, keepdim=True)
    coefficients = torch.einsum("knp,...n->...kp", basis, cells)
    explained = torch.where((coefficients * falls).sum(-1) >= 0, coefficients.square().sum(-1), 0.0)
    unexplained = 1 - explained / cells.square().sum(-1, keepdim=True).clamp_min(1e-6)
    misfit = 40 * unexplained.clamp_min(1e-3).log() + centres.square().sum(-1) / 0.2**2
    return (-misfit / 2).softmax(-1) @ centres


@functools.lru_cache(4)  # 15 MB each; the photos of one camera have one shape
def _radial_models(rows: int, columns: int) -> tuple[Tensor, Tensor, Tensor]:
    """Build models of radial brightness about each of K - 1 centres, and at last of a linear slope; float64.

    Returns:
        centres [K, 2], where the slope's is 0; an orthonormal basis [K, rows * columns, 3] of the radial pictures
        a + b log(1 + r^2) + c exp(-8 r^2), or of a + b x + c y; and [K, 3], by how much each basis picture falls from
        the centre to r = 1, 0 for the slope.
    """
    ticks = torch.arange(-12, 13, dtype=torch.float64) * (FARTHEST_FLASH_HALF_SIDES / 12)
    centres = torch.cartesian_prod(ticks, ticks)
    centres = centres[centres.square().sum(-1) <= FARTHEST_FLASH_HALF_SIDES**2 + 1e-9]
    cells = texel_positions(rows, columns, dtype=torch.float64).flatten(1).T

    def profile(squared: Tensor) -> Tensor:
        return torch.stack([torch.ones_like(squared), squared.log1p(), (-8 * squared).exp()], dim=-1)

    slope = torch.cat([torch.ones_like(cells[:, :1]), cells], dim=-1)
    pictures = torch.cat([profile((cells - centres[:, None]).square().sum(-1)), slope[None]])
    basis, triangle = torch.linalg.qr(pictures)
    centre_terms, rim_terms = profile(torch.tensor([[[0.0]], [[1.0]]], dtype=torch.float64))
    falls = (centre_terms - rim_terms).expand(len(centres), 1, 3)
    falls = torch.linalg.solve_triangular(triangle[:-1], falls, upper=True, left=False)[:, 0]
    slope_centre = torch.zeros_like(centres[:1])
    return torch.cat([centres, slope_centre]), basis, torch.cat([falls, torch.zeros_like(falls[:1])])
