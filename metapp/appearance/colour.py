"""sRGB encoding (IEC 61966-2-1), its inverse, and tone mapping."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def srgb_to_linear(srgb: Tensor) -> Tensor:
    """Display values in [0, 1] to linear values in [0, 1], of any shape.

    >>> srgb_to_linear(torch.tensor([0.0, 0.5, 1.0]))
    tensor([0.0000, 0.2140, 1.0000])
    """
    low = srgb / 12.92
    return torch.where(srgb <= 0.04045, low, ((srgb.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(linear: Tensor) -> Tensor:
    """Linear values in [0, 1] to display values in [0, 1], of any shape.

    >>> linear_to_srgb(torch.tensor([0.0, 0.2140, 1.0]))
    tensor([0.0000, 0.5000, 1.0000])
    """
    low = linear * 12.92
    return torch.where(linear <= 0.0031308, low, 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055)


def composite_to_srgb(linear: Tensor | np.ndarray) -> np.ndarray:
    """Linear RGB [H, W, 3] or, on black with coverage, [H, W, 4] to sRGB on white, in [0, 1] (IEC 61966-2-1)."""
    image = np.asarray(linear, dtype=np.float64)
    # composited after encoding, so that the rim stays as smooth as its coverage
    coverage = image[..., 3:] if image.shape[-1] == 4 else np.ones_like(image[..., :1])
    colour = np.clip(image[..., :3] / np.maximum(coverage, 1e-6), 0, 1)
    result: np.ndarray = coverage * linear_to_srgb(torch.from_numpy(colour)).numpy() + (1 - coverage)
    return result


def tone_map(radiance: Tensor) -> Tensor:
    """Linear values in [0, inf) to display values in [0, 1), of any shape: x / (1 + x), Reinhard et al. 2002, as sRGB.

    Values below 0 become 0.
    """
    light = radiance.clamp_min(0)
    return linear_to_srgb(light / (1 + light))


def stretch_to_unit_range(values: Tensor) -> tuple[Tensor, float, float]:
    """Values of any shape mapped linearly to [0, 1], and their least and greatest; 0 if all are the same.

    >>> stretched(torch.tensor([2.0, 3.0, 6.0]))
    (tensor([0.0000, 0.2500, 1.0000]), 2.0, 6.0)
    """
    low, high = values.amin(), values.amax()
    return (values - low) / torch.where(high > low, high - low, 1), float(low), float(high)
