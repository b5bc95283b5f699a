"""The sight of fits that see a material's maps, and pictures of it under some lights (--observe reference)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d
from typing_extensions import override

from metapp.appearance.svbrdf_maps import unpack_maps
from metapp.apps.svbrdf_nonstationary.map_judge import TrueMaps, fixed_pairs, log_radiance
from metapp.apps.svbrdf_nonstationary.maps import decode_photo, map_differences, pool_maps
from metapp.apps.svbrdf_nonstationary.material_sight import MaterialSight, draw_materials
from metapp.apps.svbrdf_nonstationary.photo_sight import SMOOTHING, compare_maps
from metapp.apps.svbrdf_nonstationary.photographed_maps import PhotographedMaps
from metapp.apps.svbrdf_nonstationary.variants import draw_photos
from metapp.learning.components import VisibleData
from metapp.learning.rounding import initial_smoothing, smooth_absolute
from metapp.learning.task import Params, Task, Tasks

FITTED_LIGHTS = (2, 3)  # lights that fits of the maps see the material under: anywhere above the patch, mirrored in it


class SeenMaps(NamedTuple):
    """A material's maps as fits see them.

    Attributes:
        photo: the linear photograph [T, 3, H, W], which the decoder and General's encoder read.
        maps: packed maps [T, 10, H, W].
        fitted_lights: positions of lights and viewers under which fits see the maps, [T, V, 2, 3].
        lit: the log radiance of the maps under these, [T, V, 3, H, W].
    """

    photo: Tensor
    maps: Tensor
    fitted_lights: Tensor
    lit: Tensor

    @property
    def camera_height(self) -> Tensor:
        """The heights of cameras, [T, 1]: 0, as they are not known."""
        return self.photo.new_zeros(len(self.photo), 1)


@dataclass(frozen=True)
class MapsSight(MaterialSight[PhotographedMaps, SeenMaps]):
    """The sight of a material's maps."""

    observes = "reference"
    seen_type = SeenMaps

    @override
    def prepare(self, task: Task, decoder: Any) -> SeenMaps:
        if "maps" not in task.data:
            raise ValueError(
                f"{task.name}: a flash photo, expected a material's maps; give these or a strip, or leave --observe "
                "reference out."
            )
        photo = adaptive_avg_pool2d(decode_photo(task.data["photo"]), decoder.size)
        seen = _observe(photo[None], pool_maps(task.data["maps"].float(), decoder.size)[None])
        return SeenMaps(*(tensor[0] for tensor in seen))

    @override
    def augment(self, tasks: Tasks, side: int, rng: Generator) -> tuple[SeenMaps, TrueMaps]:
        materials, truth = draw_materials(tasks, side, rng)
        return _observe(adaptive_avg_pool2d(draw_photos(materials, rng), side), truth.maps), truth

    @override
    def read_cameras(self, task: Task) -> Tensor:
        """Return the height of the camera, [1]: 0, as it is not known."""
        return torch.zeros(1, device=task.data["photo"].device)

    @override
    def loss(self, answer: PhotographedMaps, seen: SeenMaps, loss_parameters: Params) -> Tensor:
        """Return the difference of maps plus the difference of log radiance under the lights that fits see, [T]."""
        logs = log_radiance(answer.maps, seen.fitted_lights)
        log_differences = smooth_absolute(logs - seen.lit, loss_parameters)
        differences = map_differences(answer.maps, unpack_maps(seen.maps))
        return log_differences.mean((1, 2, 3, 4)) + compare_maps(differences, loss_parameters)

    @override
    def initial_loss_parameters(self, steps: int) -> Params:
        return initial_smoothing(steps, SMOOTHING)

    @override
    def photos(self, task: Task) -> None:
        """Return None: steps see no photograph."""

    @override
    def describe_visible(self, task: Task) -> VisibleData:
        """Return what steps see, all of the maps; General's encoder reads the photograph alone."""
        return VisibleData(1, task.data["maps"].nbytes, 0)


def _observe(photos: Tensor, maps: Tensor) -> SeenMaps:
    """Return what fits see of packed maps [T, 10, H, W] with linear photographs [T, 3, H, W]."""
    pairs = fixed_pairs(FITTED_LIGHTS).to(maps).expand(len(maps), -1, -1, -1)
    return SeenMaps(photos, maps, pairs, log_radiance(unpack_maps(maps), pairs))
