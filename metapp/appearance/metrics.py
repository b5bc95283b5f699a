"""Error measures of pictures."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import conv2d, pad

from metapp.appearance.colour import tone_map

LEAST_SHARE_OF_MEAN = 0.01  # of the reference's mean: the least denominator of relative errors


def mape(pictures: Tensor, references: Tensor) -> Tensor:
    """Mean absolute percentage error [T], as a share: mean |p - r| / max(r, 1 % of r's mean), linear [T, C, H, W].

    >>> mape(torch.full((1, 3, 8, 8), 0.4), torch.full((1, 3, 8, 8), 0.5))
    tensor([0.2000])
    """
    return ((pictures - references).abs() / references.clamp_min(_floor(references))).mean((1, 2, 3))


def smape(pictures: Tensor, references: Tensor) -> Tensor:
    """Symmetric mean absolute percentage error [T] in [0, 2]: mean 2 |p - r| / max(p + r, 2 % of r's mean)."""
    total = (pictures.abs() + references.abs()).maximum(2 * _floor(references))
    return (2 * (pictures - references).abs() / total).mean((1, 2, 3))


def dssim(pictures: Tensor, references: Tensor) -> Tensor:
    """Structural dissimilarity, 1 - SSIM (Wang et al. 2004), of pictures, as `tone_map_pair`: [T] in [0, 2].

    >>> pictures = torch.rand(1, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    >>> dssim(pictures, pictures)
    tensor([0.])
    """
    return 1 - ssim(*tone_map_pair(pictures, references)).flatten(1).mean(1)


def tone_map_pair(pictures: Tensor, references: Tensor) -> tuple[Tensor, Tensor]:
    """Both tone-mapped at equal exposure, divided by the reference's mean before; shapes as of `mape`."""
    exposure = references.mean((1, 2, 3), keepdim=True).clamp_min(torch.finfo(references.dtype).tiny)
    return tone_map(pictures / exposure), tone_map(references / exposure)


def si_rmse(pictures: Tensor, references: Tensor, mask: Tensor) -> Tensor:
    """Scale-invariant root mean square error [T]: of the multiple of each picture that is nearest to its reference.

    The mean is over pixels, of the squared distance of RGB vectors, as in the evaluation of StyleLight (Wang et al.
    2022) and DiffusionLight (Phongthawee et al. 2024). Black pictures have the root mean square of the reference.

    Args:
        pictures: [T, 3, H, W], linear.
        references: the same.
        mask: bool [H, W], which pixels count.
    """
    some, wanted = pictures[..., mask], references[..., mask]
    tiny = torch.finfo(some.dtype).tiny
    scale = (some * wanted).sum((1, 2), keepdim=True) / (some * some).sum((1, 2), keepdim=True).clamp_min(tiny)
    return (scale * some - wanted).square().sum(1).mean(1).sqrt()


def rgb_angle_degrees(pictures: Tensor, references: Tensor, mask: Tensor) -> Tensor:
    """Mean angle [T] between RGB vectors of pixels, degrees, each pixel counting the same.

    As in the evaluation of StyleLight and DiffusionLight, but for pixels of which one alone is black: these count 90
    degrees, not 0, else a black picture would be perfect. Shapes as of `si_rmse`.
    """
    some, wanted = pictures[..., mask], references[..., mask]
    # exact where both are nearly parallel, where the arc cosine is not
    angle = torch.atan2(torch.linalg.cross(some, wanted, dim=1).norm(dim=1), (some * wanted).sum(1))
    one_is_black = (some.amax(1) > 0) != (wanted.amax(1) > 0)
    return torch.where(one_is_black, math.pi / 2, angle).mean(1) * (180 / math.pi)


SSIM_WINDOW_RADIUS_PX, SSIM_WINDOW_SIGMA_PX = 5, 1.5  # px, of the Gaussian window about each pixel
SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2  # stabilise luminance and contrast


def ssim(pictures: Tensor, references: Tensor) -> Tensor:
    """Structural similarity about each pixel (Wang et al. 2004), of display values in [0, 1], [B, C, H, W].

    torchmetrics computes the same numbers, but takes as long to import as torch and a fit together.

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


def _floor(references: Tensor) -> Tensor:
    tiny = torch.finfo(references.dtype).tiny
    return (LEAST_SHARE_OF_MEAN * references.mean((1, 2, 3), keepdim=True)).clamp_min(tiny)
