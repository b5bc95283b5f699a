"""The outer loss of General with features of VGG-16, for training sets that lack some maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d
from typing_extensions import override

from metapp.appearance.svbrdf_maps import Maps, unpack_maps
from metapp.apps.svbrdf_nonstationary.field_judge import BLOTS_WEIGHT, MAPS_WEIGHT, PHOTO_WEIGHT
from metapp.apps.svbrdf_nonstationary.flashes import render_photo
from metapp.apps.svbrdf_nonstationary.map_judge import LitMaps, MapJudge, blots, log_radiance_difference
from metapp.apps.svbrdf_nonstationary.maps import map_differences
from metapp.apps.svbrdf_nonstationary.photo_sight import compare_photos
from metapp.apps.svbrdf_nonstationary.pretrained.ensemble_maps import UncertainMaps

PART_WEIGHTS = (1.0, 1.0, 4.0, 10.0)  # weights of the differences of maps, in the order of PARTS
LIKELIHOOD_WEIGHT = 0.03
MIN_DEVIATION = 0.01  # the least predicted error of maps


@dataclass(frozen=True)
class FeatureJudge(MapJudge):
    """The judge of maps of one photograph by two fields.

    Attributes:
        likelihood_weight: weight in the outer loss of the likelihood of predicted errors, which moves these alone.
    """

    likelihood_weight: float = LIKELIHOOD_WEIGHT

    @override
    def outer_loss(self, answer: UncertainMaps, seen: Any, truth: LitMaps) -> Tensor:
        """Return the difference of the maps and of their radiance under random lights, [T]; made-up maps do not count.

        Normals learn from their squared error alone, over the deviation that General predicts. Its minimum is the
        conditional mean, which is flat where the photograph does not tell.
        """
        maps, target, map_weights = answer.maps, unpack_maps(truth.maps), truth.map_weights
        positions = seen.positions
        differences = map_differences(maps, target)
        scale = laplace_scales(answer.deviation)[:, -1:].detach()
        squared = differences.normal.square() / scale.repeat_interleave(4, -1).repeat_interleave(4, -2)
        parts = differences._replace(normal=squared)
        errors = torch.stack([part.abs().mean((1, 2, 3)) for part in parts], 1)
        map_loss = (errors * map_weights * errors.new_tensor(PART_WEIGHTS)).sum(1)
        blot_loss = map_weights[:, 0] * blots(differences.diffuse, seen.photo)
        is_known = map_weights[:, 1:3, None, None, None] > 0  # pictures do not count where maps are made up
        specular = torch.where(is_known[:, 0], maps.specular, target.specular)
        roughness = torch.where(is_known[:, 1], maps.roughness, target.roughness)
        # pictures are of the true normals: the median of a highlight lies at a slope even where the mean slope is 0
        shown_maps = Maps(maps.diffuse, specular, roughness, target.normal)
        pictures = log_radiance_difference(shown_maps, target, truth.pairs, positions)
        photo_loss = compare_photos(render_photo(shown_maps, answer.flash, positions), seen.photo, {})
        loss = map_weights[:, 3] * (pictures + PHOTO_WEIGHT * photo_loss)
        likelihood = negative_log_likelihood(differences, answer.deviation) * map_weights.amin(1)
        return loss + MAPS_WEIGHT * map_loss + BLOTS_WEIGHT * blot_loss + self.likelihood_weight * likelihood


def laplace_scales(deviation: Tensor) -> Tensor:
    """Return the scale of a Laplace distribution of the error of each map, mean over channels, given its log."""
    return MIN_DEVIATION + deviation.exp()


def negative_log_likelihood(differences: Sequence[Tensor], deviation: Tensor) -> Tensor:
    """Return the negative log-likelihood of errors of maps but for a constant, [T] (Kendall & Gal 2017).

    Only `deviation` has a gradient of it.

    Args:
        differences: what :func:`metapp.apps.svbrdf_nonstationary.maps.map_differences` returns.
        deviation: logs of the scales, [T, 4, h, w].
    """
    scale = laplace_scales(deviation)
    size = (scale.shape[-2], scale.shape[-1])
    mean_errors = [
        adaptive_avg_pool2d(difference.detach(), size).abs().mean(1, keepdim=True) for difference in differences
    ]
    return (torch.cat(mean_errors, 1) / scale + scale.log()).mean((1, 2, 3))
