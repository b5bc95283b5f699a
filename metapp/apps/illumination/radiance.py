"""Radiance from all directions, the asset that fits and baselines of illumination answer with."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate
from typing_extensions import override

from metapp.appearance.assets import Asset
from metapp.appearance.colour import srgb_to_linear, tone_map
from metapp.appearance.latlong import level_maps
from metapp.appearance.pictures import Picture
from metapp.apps.illumination.app import Illumination
from metapp.apps.illumination.map_augmentation import normalise_luminance
from metapp.learning.task import Params, Task, add_task_axis
from metapp.rendering.second_scene import relighting


@dataclass(frozen=True, eq=False)
class Radiance(Asset):
    """An environment map: radiance from all directions.

    Attributes:
        map: linear radiance [3, H, W], of mean luminance 1.
        unit: the factor from `map` to the scale of the input's own file; 1 if there was none.
    """

    kind = "radiance"
    map: Tensor
    unit: Tensor | float = 1.0

    @property
    def size(self) -> tuple[int, int]:
        """The rows and columns of the map."""
        return self.map.shape[1], self.map.shape[2]

    def level(self, pitch_degrees: float) -> Radiance:
        """Return the light turned so that its horizon lies level.

        Args:
            pitch_degrees: how far the camera, in whose directions the map is, looked down.
        """
        return replace(self, map=level_maps(self.map[None], math.radians(pitch_degrees))[0])

    @torch.no_grad()
    def relight(self) -> Tensor:
        """Return the second scene under the map, tone-mapped, display values [3, h, w]."""
        return tone_map(relighting.relight(self.map[None]))[0]

    @override
    def pictures(self) -> dict[str, Picture]:
        """Return the map, at the scale of the input's own file, and the second scene under it."""
        scene = self.relight()
        return {
            "map": Picture((self.map * self.unit).permute(1, 2, 0), "radiance"),
            "relit": Picture(scene.permute(1, 2, 0), "srgb"),
        }

    @override
    def linear_maps(self) -> dict[str, Tensor]:
        """Return the map at the scale of the input's own file, `radiance` [H, W, 3]."""
        return {"radiance": (self.map * self.unit).permute(1, 2, 0)}

    @override
    def preview(self) -> Tensor:
        return self.draw_overview()

    def draw_overview(self, photo: Tensor | None = None) -> Tensor:
        """Draw the map above the second scene under it, and maybe a photograph beside that; linear [H, W, 3].

        Args:
            photo: the photograph of a ball, display values [3, S, S].
        """
        scene = self.relight()
        height, width = scene.shape[1:]
        photo_px = width // 3
        panorama = interpolate(tone_map(self.map[None]), size=(2 * photo_px, 4 * photo_px), mode="nearest")[0]
        column = torch.ones(3, height, photo_px)
        if photo is not None:
            column[:, :photo_px] = avg_pool2d(photo, photo.shape[-1] // photo_px)[:, :photo_px, :photo_px]
        return srgb_to_linear(torch.cat([panorama, torch.cat([scene, column], 2)], 1)).permute(1, 2, 0)


@torch.no_grad()
def make_radiance(app: Illumination, theta: Params, task: Task, size: tuple[int, int] | None) -> Radiance:
    """Return the map of a fit; see :class:`metapp.application.MakeAsset`."""
    decoder = app.decoder.resize(*size) if size else app.decoder
    light = app.sight.complete(decoder(add_task_axis(theta)), app.sight.look(task, decoder))
    return Radiance(light[0], task.data.get("scale", 1.0))


def radiance_of(prediction: Tensor, task: Task) -> Radiance:
    """Return predicted radiance [1, 3, H, W], of any scale, at the scale of the file of the task."""
    return Radiance(normalise_luminance(prediction)[0], task.data.get("scale", 1.0))
