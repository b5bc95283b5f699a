"""The sight of fits of illumination that see the environment map itself (--observe reference)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from typing_extensions import override

from metapp.apps.illumination.light_sight import LightSight
from metapp.apps.illumination.lighting import LightField, Lighting
from metapp.apps.illumination.map_augmentation import normalise_luminance
from metapp.apps.illumination.radiance_losses import (
    INITIAL_SMOOTHING,
    TrueMap,
    compare_reflected_radiance,
    compare_texels,
    prepare_map,
)
from metapp.apps.illumination.suns import SUN_SPECS, find_suns, split_suns
from metapp.learning.components import VisibleData
from metapp.learning.rounding import initial_smoothing
from metapp.learning.task import Params, Task, Tasks, TensorSpec

# A texel's weight in the inner loss is its solid angle times (1 + LIGHT_WEIGHT * radiance), where radiance is 1 on
# average: bright texels count more, so that few steps find suns.
LIGHT_WEIGHT = 0.3


class SeenMap(NamedTuple):
    """A map as fits see it.

    Attributes:
        photo: the photograph of a sphere under the map, uint8 [T, 3, S, S], which General's encoder reads.
        map: linear radiance [T, 3, H, W], of mean luminance 1, at the size of fits.
        reflected: the radiance that surfaces reflect under the map, [T, 3, S'], see :func:`reflect_radiance`.
        suns: the brightest small lights of the map, [T, SUN_COUNT, SUN_NUMBERS].
    """

    photo: Tensor
    map: Tensor
    reflected: Tensor
    suns: Tensor


@dataclass(frozen=True)
class MapSight(LightSight[SeenMap]):
    """The sight of a map: all of its texels, and its brightest small lights, which are found in closed form."""

    observes = "reference"
    seen_type = SeenMap

    @override
    def prepare(self, task: Task, decoder: LightField) -> SeenMap:
        if "map" not in task.data:
            raise ValueError(
                f"{task.name}: a photo, expected an HDR map, .exr or .hdr; leave --observe reference out if it shows a "
                "ball; if it shows a surface, take the application texture, svbrdf_stationary or svbrdf_nonstationary."
            )
        seen = self.observe(prepare_map(task, decoder.network), task.data["photos"][:1])
        return SeenMap(*(tensor[0] for tensor in seen))

    @override
    def observe(self, truth: TrueMap, photos: Tensor) -> SeenMap:
        return SeenMap(photos, *truth, find_suns(truth.map))

    @override
    def task_parameters(self, tasks: Tasks, decoder: LightField) -> Params:
        """Return the suns of the maps, which steps leave as they are."""
        return split_suns(tasks.data["suns"][tasks.rows])

    @property
    @override
    def task_parameter_specs(self) -> Mapping[str, TensorSpec]:
        return SUN_SPECS

    @override
    def loss(self, answer: Lighting, seen: SeenMap, loss_parameters: Params) -> Tensor:
        """Return the difference of each fit from the map, [T].

        It has three terms: the log radiance of texels, the radiance that surfaces reflect, and the log of that
        radiance. A learned `light` [T] is the log of a weight that replaces LIGHT_WEIGHT; for a learned `smoothing` see
        :func:`smooth_absolute`.
        """
        light_weight = torch.exp(loss_parameters["light"])[:, None, None, None] if loss_parameters else LIGHT_WEIGHT
        differences, log_differences = compare_reflected_radiance(answer.maps, seen.reflected, loss_parameters)
        reflected_loss = (differences + log_differences).mean((1, 2))
        return compare_texels(answer.maps, seen.map, loss_parameters, light_weight) + reflected_loss

    @override
    def initial_loss_parameters(self, steps: int) -> Params:
        return initial_smoothing(steps, INITIAL_SMOOTHING) | {"light": torch.full((steps,), math.log(LIGHT_WEIGHT))}

    @override
    def complete(self, answer: Lighting, seen: SeenMap) -> Tensor:
        """Return the fitted maps [T, 3, H, W], of mean luminance 1."""
        return normalise_luminance(answer.maps)

    @override
    def describe_visible(self, task: Task) -> VisibleData:
        """Return what steps see, all of the map; General's encoder reads the photograph alone."""
        return VisibleData(1, task.data["map"].nbytes, 0)
