"""The sight of fits of illumination that see nothing but the LDR photograph of a sphere (--observe photo).

They find the light under which a sphere of some material looks so through some camera. If that sphere is a mirror, the
task may hold the light in it, see `mirror`, and a fit adds the rest of the map.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, relu
from typing_extensions import override

from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.latlong import sphere_normals
from metapp.appearance.pictures import PictureComparison
from metapp.apps.illumination.light_sight import LightSight
from metapp.apps.illumination.lighting import LightField, Lighting
from metapp.apps.illumination.map_augmentation import normalise_luminance
from metapp.apps.illumination.mirror import (
    CLIPPED_DISPLAY_VALUE,
    MirrorLight,
    complete_maps,
    mirror_loss,
    read_mirror_light,
    scale_to_seen,
    shows_mirror,
)
from metapp.apps.illumination.radiance_losses import INITIAL_SMOOTHING, TrueMap
from metapp.learning.components import VisibleData
from metapp.learning.rounding import initial_smoothing, smooth_absolute
from metapp.learning.task import Params, Task

LOSS_PHOTO_PX = 32  # side of the photograph in the loss


class SeenBall(NamedTuple):
    """The photograph of a sphere as fits see it.

    Attributes:
        photo: the photograph, uint8 [T, 3, S, S].
        seen, certain: the light in the sphere, if it is a mirror, see :class:`MirrorLight`; zeros for other spheres.
    """

    photo: Tensor
    seen: Tensor
    certain: Tensor

    @property
    def mirror(self) -> MirrorLight:
        """The light in the sphere."""
        return MirrorLight(self.seen, self.certain)


@dataclass(frozen=True)
class BallSight(LightSight[SeenBall]):
    """The sight of one photograph of a sphere."""

    observes = "photo"
    seen_type = SeenBall

    @override
    def prepare(self, task: Task, decoder: LightField) -> SeenBall:
        return SeenBall(task.data["photos"][0], *read_mirror_light(task, decoder.network.height, decoder.network.width))

    @override
    def observe(self, truth: TrueMap, photos: Tensor) -> SeenBall:
        return SeenBall(photos, torch.zeros_like(truth.map), torch.zeros_like(truth.map[:, :2]))

    @override
    def loss(self, answer: Lighting, seen: SeenBall, loss_parameters: Params) -> Tensor:
        """Return the difference of each fit from the photograph, [T].

        For a task whose photograph shows a mirror, the fitted map is compared with the light in the mirror. For every
        other task a photograph is rendered from the fitted map, sphere and camera, and display values are compared.
        """
        return torch.where(
            shows_mirror(seen.mirror),
            mirror_loss(answer.maps, seen.mirror, loss_parameters),
            compare_display_values(answer, seen.photo, loss_parameters),
        )

    @override
    def initial_loss_parameters(self, steps: int) -> Params:
        return initial_smoothing(steps, INITIAL_SMOOTHING)

    @override
    def complete(self, answer: Lighting, seen: SeenBall) -> Tensor:
        """Return the maps [T, 3, H, W] of mean luminance 1, with the light in a mirror where it is seen."""
        return normalise_luminance(complete_maps(answer.maps, seen.mirror))

    @override
    def look(self, task: Task, decoder: LightField) -> SeenBall:
        """Return the light in a mirror, if the task holds it, without the photograph, which completes nothing."""
        light = read_mirror_light(task, decoder.network.height, decoder.network.width)
        return SeenBall(light[0].new_zeros(()), *(tensor[None] for tensor in light))

    @override
    def show_photo(self, task: Task) -> Tensor:
        return task.data["photos"][0] / 255

    @override
    def compare_photo(self, answer: Lighting, seen: SeenBall) -> PictureComparison:
        """Return the ball as the fit makes it beside its photograph; of a mirror, the light in it, unwrapped."""
        if shows_mirror(seen.mirror)[0]:
            maps, light = (
                linear_to_srgb(light.clamp(0, 1)) for light in (scale_to_seen(answer.maps, seen.mirror), seen.seen)
            )
            return PictureComparison(maps, light, seen.certain[0, 0] > 0.5)
        side = seen.photo.shape[-1]
        return PictureComparison(answer.photograph(side), seen.photo / 255, sphere_normals(side)[1])

    @override
    def describe_visible(self, task: Task) -> VisibleData:
        """Return what steps see, all of the photograph, which General's encoder reads, too."""
        return VisibleData(1, task.data["photos"][0].nbytes, 1)


def compare_display_values(answer: Lighting, photos: Tensor, loss_parameters: Params) -> Tensor:
    """Return the mean difference of rendered photographs from photographs [T, 3, S, S] in display values, [T].

    Where a photograph clips, it is a lower bound: only darker renderings differ from it.
    """
    side = photos.shape[-1]
    target = avg_pool2d(photos.to(answer.maps) / 255, side // LOSS_PHOTO_PX)
    shortfall = target - answer.photograph(LOSS_PHOTO_PX)
    shortfall = torch.where(target > CLIPPED_DISPLAY_VALUE, relu(shortfall), shortfall)
    differences = smooth_absolute(shortfall, loss_parameters).flatten(2)
    return differences[..., _find_inner_pixels(side, answer.maps.device)].mean((1, 2))


@functools.lru_cache(maxsize=4)
def _find_inner_pixels(side: int, device: torch.device) -> Tensor:
    """Find the pixels of a reduced photograph, LOSS_PHOTO_PX a side, that lie wholly inside the sphere's outline.

    Args:
        side: side in px of the photograph before it is reduced.
        device: device of the indices.

    Returns:
        Their indices [P] into all pixels of the reduced photograph, which are counted row by row from the top.
    """
    is_inside = avg_pool2d(sphere_normals(side)[1].float()[None], side // LOSS_PHOTO_PX)[0] > 0.999
    return is_inside.flatten().nonzero()[:, 0].to(device)
