"""sRGB encoding (IEC 61966-2-1), both ways."""

from __future__ import annotations

import torch
from torch import Tensor


def srgb_to_linear(srgb: Tensor) -> Tensor:
    """Display values in [0, 1] to linear values in [0, 1], of any shape."""
    low = srgb / 12.92
    return torch.where(srgb <= 0.04045, low, ((srgb.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(linear: Tensor) -> Tensor:
    """Linear values in [0, 1] to display values in [0, 1], of any shape."""
    low = linear * 12.92
    return torch.where(linear <= 0.0031308, low, 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055)


def tone_map(linear: Tensor) -> Tensor:
    """Linear radiance in [0, inf) to linear display values in [0, 1): x / (1 + x) (Reinhard et al. 2002)."""
    return linear / (1 + linear)
