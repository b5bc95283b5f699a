"""Measures of textures, whose pixels need not lie where the exemplar has them.

They compare distributions of features and the order of a pattern. This module knows pictures and references, but not
the application that made them.
"""

from __future__ import annotations

import torch
from torch import Generator, Tensor

from metapp.appearance.features import load_features
from metapp.appearance.lattice import find_lattice, kept_order_share
from metapp.appearance.picture_measures import PictureMeasure
from metapp.appearance.pictures import PictureComparison

WASSERSTEIN_TAPS = ("relu2_2", "relu3_3", "relu4_3")  # of VGG-16, at which distributions of features are compared
PROJECTION_DIRECTIONS = 64


@torch.no_grad()
def wasserstein(compared: PictureComparison) -> float:
    """Return the sliced Wasserstein distance of features of textures and of one reference, the mean over taps."""
    features = load_features(WASSERSTEIN_TAPS, compared.references)
    pairs = zip(features(compared.pictures), features(compared.references), strict=True)
    return float(torch.stack([sliced_wasserstein(*pair) for pair in pairs]).mean())


def sliced_wasserstein(maps: Tensor, target_maps: Tensor) -> Tensor:
    """Return the sliced Wasserstein distance of distributions of features over pixels (Heitz et al. 2021).

    Features are projected onto random directions and sorted; the mean distance of sorted projections is divided by the
    mean deviation of the target's projections.

    Args:
        maps: features of B pictures, [B, C, H, W].
        target_maps: features of the target, [1, C, H, W].

    Returns:
        The distances, [B].
    """
    rng = Generator(maps.device).manual_seed(0)
    directions = torch.randn(PROJECTION_DIRECTIONS, maps.shape[1], generator=rng, device=maps.device, dtype=maps.dtype)
    directions = directions / directions.norm(dim=1, keepdim=True)
    projections, target_projections = (
        (directions @ features.flatten(2)).sort(2).values for features in (maps, target_maps)
    )
    deviation = (target_projections - target_projections.mean(2, keepdim=True)).abs().mean(2)
    result: Tensor = ((projections - target_projections).abs().mean(2) / deviation.clamp_min(1e-12)).mean(1)
    return result


def order_measure(compared: PictureComparison) -> float:
    """Return the share of the exemplar's order that a texture keeps; NaN if the exemplar has no order."""
    return kept_order_share(find_lattice(compared.references[0]), compared.pictures[0])


WASSERSTEIN = PictureMeasure(wasserstein)
ORDER = PictureMeasure(order_measure, more_is_better=True)
