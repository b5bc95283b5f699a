"""Error measures of pictures, as plain functions of two tensors.

Applications state their errors by these; :mod:`metapp.appearance.picture_measures` registers some for all pictures.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import conv2d, pad

from metapp.appearance.colour import tone_map

LEAST_SHARE_OF_MEAN = 0.01  # least denominator of relative errors, as a share of the reference's mean


def mape(pictures: Tensor, references: Tensor) -> Tensor:
    """Compute the mean absolute percentage error as a share: mean |p - r| / max(r, 1 % of r's mean).

    Args:
        pictures: p, linear, [T, C, H, W].
        references: r, linear, [T, C, H, W].

    Returns:
        [T], >= 0.

    >>> mape(torch.full((1, 3, 8, 8), 0.4), torch.full((1, 3, 8, 8), 0.5))
    tensor([0.2000])
    """
    return ((pictures - references).abs() / references.clamp_min(_least_denominator(references))).mean((1, 2, 3))


def smape(pictures: Tensor, references: Tensor) -> Tensor:
    """Compute the symmetric mean absolute percentage error: mean 2 |p - r| / max(p + r, 2 % of r's mean).

    Args:
        pictures: p, linear, [T, C, H, W].
        references: r, linear, [T, C, H, W].

    Returns:
        [T] in [0, 2].
    """
    total = (pictures.abs() + references.abs()).maximum(2 * _least_denominator(references))
    return (2 * (pictures - references).abs() / total).mean((1, 2, 3))


def dssim(pictures: Tensor, references: Tensor) -> Tensor:
    """Compute structural dissimilarity, 1 - SSIM (Wang et al. 2004), of pictures after :func:`tone_map_pair`.

    Args:
        pictures: linear, [T, C, H, W].
        references: linear, [T, C, H, W].

    Returns:
        [T] in [0, 2].

    >>> pictures = torch.rand(1, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    >>> dssim(pictures, pictures)
    tensor([0.])
    """
    return 1 - ssim(*tone_map_pair(pictures, references)).flatten(1).mean(1)


def tone_map_pair(pictures: Tensor, references: Tensor) -> tuple[Tensor, Tensor]:
    """Tone-map pictures and references at equal exposure: both are divided by the mean of the reference before.

    Args:
        pictures: linear, [T, C, H, W].
        references: linear, [T, C, H, W].

    Returns:
        Display values in [0, 1), [T, C, H, W] both.
    """
    exposure = references.mean((1, 2, 3), keepdim=True).clamp_min(torch.finfo(references.dtype).tiny)
    return tone_map(pictures / exposure), tone_map(references / exposure)


def si_rmse(pictures: Tensor, references: Tensor, mask: Tensor) -> Tensor:
    """Compute the scale-invariant root mean square error [T]: of the multiple of each picture nearest to its reference.

    The mean is over pixels, of the squared distance of RGB vectors, as in the evaluation of StyleLight (Wang et al.
    2022) and DiffusionLight (Phongthawee et al. 2024). Black pictures have the root mean square of the reference.

    Args:
        pictures: [T, 3, H, W], linear.
        references: [T, 3, H, W], linear.
        mask: bool [H, W], which pixels count.
    """
    colours, targets = pictures[..., mask], references[..., mask]
    tiny = torch.finfo(colours.dtype).tiny
    scale = (colours * targets).sum((1, 2), keepdim=True) / (colours * colours).sum((1, 2), keepdim=True).clamp_min(
        tiny
    )
    return (scale * colours - targets).square().sum(1).mean(1).sqrt()


def rgb_angle_degrees(pictures: Tensor, references: Tensor, mask: Tensor) -> Tensor:
    """Compute the mean angle [T] between RGB vectors of pixels, in degrees, each pixel counting the same.

    It is the measure in the evaluation of StyleLight and DiffusionLight, but for pixels of which one alone is black:
    these count 90 degrees, not 0, else a black picture would be perfect.

    Args:
        pictures: [T, 3, H, W], linear.
        references: [T, 3, H, W], linear.
        mask: bool [H, W], which pixels count.
    """
    colours, targets = pictures[..., mask], references[..., mask]
    # the arc tangent is exact where both are nearly parallel; the arc cosine is not
    angle = torch.atan2(torch.linalg.cross(colours, targets, dim=1).norm(dim=1), (colours * targets).sum(1))
    one_is_black = (colours.amax(1) > 0) != (targets.amax(1) > 0)
    return torch.where(one_is_black, math.pi / 2, angle).mean(1) * (180 / math.pi)


# radius and standard deviation of the Gaussian window about each pixel, px
SSIM_WINDOW_RADIUS_PX, SSIM_WINDOW_SIGMA_PX = (
    5,
    1.5,
)
SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2  # C1 and C2 of Wang et al., which stabilise luminance and contrast


def ssim(pictures: Tensor, references: Tensor) -> Tensor:
    """Compute structural similarity about each pixel (Wang et al. 2004) of display values.

    torchmetrics computes the same numbers, but takes as long to import as torch and a fit together.

    Args:
        pictures: display values in [0, 1], [B, C, H, W].
        references: display values in [0, 1], [B, C, H, W].

    Returns:
        [B, C, H, W] in [-1, 1]; the mean over a picture is its SSIM.
    """
    window = torch.arange(
        -SSIM_WINDOW_RADIUS_PX, SSIM_WINDOW_RADIUS_PX + 1, dtype=pictures.dtype, device=pictures.device
    )
    window = torch.exp(-((window / SSIM_WINDOW_SIGMA_PX) ** 2) / 2)
    window = (window / window.sum())[None]
    kernel = (window.T @ window).expand(pictures.shape[1], 1, -1, -1)
    a, b = (pad(images, (SSIM_WINDOW_RADIUS_PX,) * 4, mode="reflect") for images in (pictures, references))
    means = conv2d(torch.cat([a, b, a * a, b * b, a * b]), kernel, groups=pictures.shape[1])
    mean_a, mean_b, aa, bb, ab = means.split(len(pictures))
    square_a, square_b, product = mean_a * mean_a, mean_b * mean_b, mean_a * mean_b
    variances = (aa - square_a).clamp_min(0) + (bb - square_b).clamp_min(0)
    numerator = (2 * product + SSIM_C1) * (2 * (ab - product) + SSIM_C2)
    result: Tensor = numerator / ((square_a + square_b + SSIM_C1) * (variances + SSIM_C2))
    return result


def _least_denominator(references: Tensor) -> Tensor:
    tiny = torch.finfo(references.dtype).tiny
    return (LEAST_SHARE_OF_MEAN * references.mean((1, 2, 3), keepdim=True)).clamp_min(tiny)
