"""Measures of each pixel by itself."""

from __future__ import annotations

import functools
import importlib.metadata

import numpy as np
import torch
from torch import Tensor

from metapp.appearance.colorimetry import colour_difference
from metapp.appearance.picture_measures import PictureMeasure
from metapp.appearance.pictures import PictureComparison

MAX_PSNR_DB = 100.0  # dB, of pictures that are equal to rounding


def psnr(compared: PictureComparison) -> float:
    """Peak signal-to-noise ratio in dB, -10 log10 of the mean square error of display values; the mean over pictures.

    At most MOST_DB, which pictures have that are equal.
    """
    wrong = (compared.pictures - compared.references).square()
    errors = _counted(wrong, compared).flatten(1).mean(1)
    return float(-10 * errors.clamp_min(10 ** (-MAX_PSNR_DB / 10)).log10().mean())


def difference_quantile(compared: PictureComparison, share: float) -> float:
    """The quantile of a share, over pixels, of the CIE 2000 colour difference."""
    pictures, references = (
        _counted(each, compared).transpose(1, 2).flatten(0, 1).double().numpy() for each in compared[:2]
    )
    return float(np.quantile(colour_difference(pictures, references), share))


def describe_colour_package() -> str:
    """The package of colour differences."""
    return f"by colour-science {importlib.metadata.version('colour-science')}"


def _counted(values: Tensor, compared: PictureComparison) -> Tensor:
    """Values [B, 3, H, W] of the pixels that count, [B, 3, N]."""
    return values.flatten(2) if compared.mask is None else values[..., compared.mask.to(torch.bool)]


PSNR = PictureMeasure(psnr, more_is_better=True)
MEDIAN_COLOUR_DIFFERENCE = PictureMeasure(functools.partial(difference_quantile, share=0.5), describe_colour_package)
HIGH_COLOUR_DIFFERENCE = PictureMeasure(functools.partial(difference_quantile, share=0.95), describe_colour_package)
