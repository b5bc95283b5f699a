"""The judge of illumination: environment maps are judged by what they light."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor
from typing_extensions import override

from metapp.apps.illumination.ball_sight import SeenBall, compare_display_values
from metapp.apps.illumination.lighting import LightField, Lighting
from metapp.apps.illumination.map_augmentation import normalise_luminance
from metapp.apps.illumination.map_sight import SeenMap
from metapp.apps.illumination.radiance_losses import (
    TrueMap,
    compare_reflected_radiance,
    compare_texels,
    prepare_map,
)
from metapp.apps.illumination.spheres import FACING_SURFACES, MIRRORING_SURFACES, sphere_errors
from metapp.learning.components import Judge
from metapp.learning.task import Task
from metapp.rendering.second_scene import relighting

# Weights of terms of the outer loss, in which the radiance that diffuse surfaces reflect has weight 1
TEXELS_WEIGHT = 0.3  # of the log radiance of texels
GLOSSY_WEIGHT = 0.3  # of the radiance that glossy surfaces reflect
LOGS_WEIGHT = 0.2  # of the log radiance that all surfaces reflect
PHOTO_WEIGHT = 0.3  # of the photograph


@dataclass(frozen=True)
class RelitJudge(Judge[Lighting, SeenMap | SeenBall, TrueMap]):
    """The judge of maps by a second scene and by spheres under them."""

    truth_type = sampled_type = TrueMap

    @override
    def prepare(self, task: Task, decoder: LightField) -> TrueMap | None:
        if "map" not in task.data:
            return None
        return TrueMap(*(tensor[0] for tensor in prepare_map(task, decoder.network)))

    @override
    def errors(self, prediction: Tensor, seen: SeenMap | SeenBall, truth: TrueMap) -> dict[str, Tensor]:
        """Measure how far maps are off.

        Args:
            prediction: linear radiance [T, 3, H, W] at any scale, of the size of fits.
            seen: what fits see of the maps.
            truth: the true maps.

        Returns:
            `error`, the mean absolute difference of the second scene's pictures; `map`, the mean difference of log
            radiance; and errors of three spheres under the maps: see :func:`sphere_errors`. Each is [T].
        """
        maps, target = normalise_luminance(prediction), truth.map
        error = (relighting.relight(maps) - relighting.relight(target)).abs().mean((1, 2, 3))
        return {"error": error, "map": compare_texels(maps, target, {}, 0.0), **sphere_errors(maps, target)}

    @override
    def outer_loss(self, answer: Lighting, seen: SeenMap | SeenBall, truth: TrueMap) -> Tensor:
        """Return the difference of each fit from the true map and from the photograph, [T].

        It is a weighted sum: the radiance that diffuse surfaces reflect has weight 1, what glossy ones reflect
        GLOSSY_WEIGHT, the logs of both LOGS_WEIGHT, the log radiance of texels TEXELS_WEIGHT and the photograph
        PHOTO_WEIGHT. The photograph is compared with the maps as they are fitted, since the camera's exposure belongs
        to their unit; for all other terms their luminance is normalised.
        """
        maps = normalise_luminance(answer.maps)
        differences, log_differences = compare_reflected_radiance(maps, truth.reflected, {})
        diffuse_loss, glossy_loss = (
            part.mean((1, 2)) for part in differences.split((FACING_SURFACES, MIRRORING_SURFACES), 2)
        )
        result: Tensor = (
            diffuse_loss
            + GLOSSY_WEIGHT * glossy_loss
            + LOGS_WEIGHT * log_differences.mean((1, 2))
            + TEXELS_WEIGHT * compare_texels(maps, truth.map, {}, 0.0)
            + PHOTO_WEIGHT * compare_display_values(answer, seen.photo, {})
        )
        return result
