"""Measures of textures, for which not one pixel must be where the exemplar has it."""

from __future__ import annotations

import torch
from torch import Generator, Tensor

from metapp.appearance.features import load_features
from metapp.appearance.order import find_lattice, kept_order_share
from metapp.appearance.picture_measures import PictureMeasure
from metapp.appearance.pictures import PictureComparison

WASSERSTEIN_TAPS = ("relu2_2", "relu3_3", "relu4_3")  # beside those that fits are compared by
PROJECTION_DIRECTIONS = 64


@torch.no_grad()
def wasserstein(compared: PictureComparison) -> float:
    """Sliced Wasserstein distance of features, the mean over taps and textures; of one reference."""
    features = load_features(WASSERSTEIN_TAPS, compared.references)
    pairs = zip(features(compared.pictures), features(compared.references), strict=True)
    return float(torch.stack([sliced_wasserstein(*pair) for pair in pairs]).mean())


def sliced_wasserstein(maps: Tensor, target: Tensor) -> Tensor:
    """Distance [B] of the distributions of features over pixels, along random directions (Heitz et al. 2021).

    The mean distance of sorted projections over the target's mean deviation, of maps [B, C, H, W] and [1, C, H, W].
    """
    rng = Generator(maps.device).manual_seed(0)
    directions = torch.randn(PROJECTION_DIRECTIONS, maps.shape[1], generator=rng, device=maps.device, dtype=maps.dtype)
    directions = directions / directions.norm(dim=1, keepdim=True)
    projected, wanted = ((directions @ features.flatten(2)).sort(2).values for features in (maps, target))
    deviation = (wanted - wanted.mean(2, keepdim=True)).abs().mean(2)
    result: Tensor = ((projected - wanted).abs().mean(2) / deviation.clamp_min(1e-12)).mean(1)
    return result


def order_measure(compared: PictureComparison) -> float:
    """The share of the exemplar's order that a texture keeps; NaN if the exemplar has none."""
    return kept_order_share(find_lattice(compared.references[0]), compared.pictures[0])


WASSERSTEIN = PictureMeasure(wasserstein)
ORDER = PictureMeasure(order_measure, more_is_better=True)
