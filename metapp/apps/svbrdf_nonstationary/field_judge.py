"""The outer loss of maps by a field: pictures, maps, the photograph, steepness and blots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d
from typing_extensions import override

from metapp.appearance.svbrdf_maps import Maps, tilt_sine, unpack_maps
from metapp.apps.svbrdf_nonstationary.map_judge import LEVEL_SINE, LitMaps, MapJudge, blots, log_radiance_difference
from metapp.apps.svbrdf_nonstationary.maps import map_differences
from metapp.apps.svbrdf_nonstationary.photo_sight import compare_maps, compare_photos
from metapp.apps.svbrdf_nonstationary.photographed_maps import PhotographedMaps

MAPS_WEIGHT, PHOTO_WEIGHT = 0.3, 0.3  # weights in the outer loss, beside 1 for pictures under other lights
STEEPNESS_WEIGHT = 0.2  # weight in the outer loss of the mean steepness of normals, which a photo hardly shows
BLOTS_WEIGHT = 0.3  # weight in the outer loss of diffuse colours where the photo clips
STEEPNESS_CELLS = 8  # cells a side, in each of which the mean steepness of normals counts


@dataclass(frozen=True)
class FieldJudge(MapJudge):
    """The judge of maps that a field makes, whatever its fits see.

    Attributes:
        steepness_weight, blots_weight: weights of terms of the outer loss, beside 1 for pictures under lights.
    """

    steepness_weight: float = STEEPNESS_WEIGHT
    blots_weight: float = BLOTS_WEIGHT

    @override
    def outer_loss(self, answer: PhotographedMaps, seen: Any, truth: LitMaps) -> Tensor:
        """Return the outer loss of each fit, [T].

        It has differences of log radiance under random lights, of maps, of the photograph, of steepness, and of diffuse
        colours where the photograph clips. The mean steepness of normals counts since the normals with the least mean
        difference from all that a photo allows are flat.
        """
        maps, target = answer.maps, unpack_maps(truth.maps)
        pictures = log_radiance_difference(maps, target, truth.pairs)
        photo = compare_photos(answer.render(), seen.photo, {})
        steepness_difference = (_steepness(maps) / _steepness(target)).log().abs().mean((1, 2, 3))
        differences = map_differences(maps, target)
        # roughness and normals count twice, as photos say less of them
        map_loss = compare_maps(differences, {}) + compare_maps((differences.roughness, differences.normal), {})
        loss = pictures + MAPS_WEIGHT * map_loss + PHOTO_WEIGHT * photo + self.steepness_weight * steepness_difference
        return loss + self.blots_weight * blots(differences.diffuse, seen.photo)


def _steepness(maps: Maps) -> Tensor:
    """Return the mean sine of the tilt of normals in each cell, plus a little, so that it has a log, [T, 1, 8, 8]."""
    return adaptive_avg_pool2d(tilt_sine(maps.normal), STEEPNESS_CELLS) + 2 * LEVEL_SINE
