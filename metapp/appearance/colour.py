"""sRGB encoding (IEC 61966-2-1), display gamma, their inverses, and tone mapping: ways from linear values to the eye.

Nothing here reads or writes files.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

DISPLAY_GAMMA = 2.2  # power by which a display turns values into radiance


def srgb_to_linear(srgb: Tensor) -> Tensor:
    """Convert display values in [0, 1] to linear values in [0, 1], of any shape.

    >>> srgb_to_linear(torch.tensor([0.0, 0.5, 1.0]))
    tensor([0.0000, 0.2140, 1.0000])
    """
    linear_segment = srgb / 12.92
    return torch.where(srgb <= 0.04045, linear_segment, ((srgb.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(linear: Tensor) -> Tensor:
    """Convert linear values in [0, 1] to display values in [0, 1], of any shape.

    >>> linear_to_srgb(torch.tensor([0.0, 0.2140, 1.0]))
    tensor([0.0000, 0.5000, 1.0000])
    """
    linear_segment = linear * 12.92
    return torch.where(linear <= 0.0031308, linear_segment, 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055)


def radiance_to_display(radiance: Tensor) -> Tensor:
    """Convert linear radiance of any shape, 1 is white, to display values in [0.002, 1]: clamp to [1e-6, 1], gamma 2.2.

    The floor keeps the slope at black finite (850) and is less than half a step of 8 bits. Outside the range the
    gradient is 0: a descent must begin dark enough, since a picture that is over-exposed all over has none.
    """
    return radiance.clamp(1e-6, 1.0) ** (1 / DISPLAY_GAMMA)


def composite_to_srgb(linear: Tensor | np.ndarray) -> np.ndarray:
    """Convert linear RGB to sRGB display values in [0, 1], [H, W, 3], composited on white where it has coverage.

    Args:
        linear: [H, W, 3], or, on black with coverage, [H, W, 4].
    """
    image = np.asarray(linear, dtype=np.float64)
    # composited after encoding, so that the rim of a disc looks as smooth as its coverage is
    coverage = image[..., 3:] if image.shape[-1] == 4 else np.ones_like(image[..., :1])
    colour = np.clip(image[..., :3] / np.maximum(coverage, 1e-6), 0, 1)
    composite: np.ndarray = coverage * linear_to_srgb(torch.from_numpy(colour)).numpy() + (1 - coverage)
    return composite


def tone_map(radiance: Tensor) -> Tensor:
    """Tone-map linear values in [0, inf) of any shape to display values in [0, 1): x / (1 + x), encoded as sRGB.

    The operator is from Reinhard et al. 2002. Values below 0 become 0.
    """
    positive = radiance.clamp_min(0)
    return linear_to_srgb(positive / (1 + positive))


def stretch_to_unit_range(values: Tensor) -> tuple[Tensor, float, float]:
    """Map values of any shape linearly to [0, 1], and return their least and greatest, too; 0 if all are the same.

    >>> stretch_to_unit_range(torch.tensor([2.0, 3.0, 6.0]))
    (tensor([0.0000, 0.2500, 1.0000]), 2.0, 6.0)
    """
    least, greatest = values.amin(), values.amax()
    return (values - least) / torch.where(greatest > least, greatest - least, 1), float(least), float(greatest)
