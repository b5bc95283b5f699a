"""Measures that compare each pixel by itself: PSNR, and quantiles of CIE 2000 colour differences.

This module knows pictures, references and masks, but neither networks nor applications.
"""

from __future__ import annotations

import functools
import importlib.metadata

import numpy as np
import torch
from torch import Tensor

from metapp.appearance.colorimetry import colour_difference
from metapp.appearance.picture_measures import PictureMeasure
from metapp.appearance.pictures import PictureComparison

MAX_PSNR_DB = 100.0  # of pictures that are equal to rounding, whose PSNR would be infinite


def psnr(compared: PictureComparison) -> float:
    """Return the peak signal-to-noise ratio in dB, the mean over pictures.

    It is -10 log10 of the mean square error of display values, and at most MAX_PSNR_DB, the ratio of equal pictures.
    """
    squared_differences = (compared.pictures - compared.references).square()
    errors = _select_pixels(squared_differences, compared).flatten(1).mean(1)
    return float(-10 * errors.clamp_min(10 ** (-MAX_PSNR_DB / 10)).log10().mean())


def difference_quantile(compared: PictureComparison, share: float) -> float:
    """Return a quantile over pixels of the CIE 2000 colour difference.

    Args:
        compared: pictures and references, of which masked pixels are left out.
        share: share of pixels below the quantile; 0.5 is the median.
    """
    pictures, references = (
        _select_pixels(images, compared).transpose(1, 2).flatten(0, 1).double().numpy() for images in compared[:2]
    )
    return float(np.quantile(colour_difference(pictures, references), share))


def describe_colour_package() -> str:
    """Say by which version of colour-science colour differences are computed."""
    return f"by colour-science {importlib.metadata.version('colour-science')}"


def _select_pixels(values: Tensor, compared: PictureComparison) -> Tensor:
    """Return the values at the pixels that the mask of a comparison selects, all pixels without a mask.

    Args:
        values: one value for each pixel and channel, [B, 3, H, W].
        compared: pictures, references and their mask.

    Returns:
        The selected values, [B, 3, N].
    """
    return values.flatten(2) if compared.mask is None else values[..., compared.mask.to(torch.bool)]


PSNR = PictureMeasure(psnr, more_is_better=True)
MEDIAN_COLOUR_DIFFERENCE = PictureMeasure(functools.partial(difference_quantile, share=0.5), describe_colour_package)
HIGH_COLOUR_DIFFERENCE = PictureMeasure(functools.partial(difference_quantile, share=0.95), describe_colour_package)
