"""Presentation of fitted illumination: maps, a second scene under them, photographed balls, remarks and warnings.

Maps are shown as the application's prediction, at a mean luminance of 1; files have the scale of a task's own file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate
from typing_extensions import override

from metapp.appearance.colour import srgb_to_linear, tone_map
from metapp.appearance.latlong import level_maps
from metapp.appearance.pictures import Picture, PictureComparison, VisibleData
from metapp.appearance.presenter import Presenter
from metapp.appearance.uniform import collapsed_fit_warnings, uniform_input_remarks
from metapp.apps.illumination.app import Illumination
from metapp.apps.illumination.map_augmentation import normalise_luminance
from metapp.learning.app import stack_tasks
from metapp.learning.task import Params, Task, Tasks, add_task_axis
from metapp.rendering.second_scene import relighting

LARGEST_MAP_ROWS = 1024  # rows of the file of a map, at most


@dataclass(frozen=True)
class IlluminationPresenter(Presenter[Illumination]):
    """The presenter of fitted environment maps; `size` is the size of the file `map`.

    Attributes:
        pitch: how far the camera looked down at a ball, in degrees. Files are levelled by it; errors and comparisons
            with a photo are in directions of the camera.
    """

    pitch: float = 0.0

    picture_measure = "the second scene under the map, tone-mapped"

    @override
    def size_refusal(self, height: int, width: int) -> str:
        fits = 2 * height == width and 16 <= height <= LARGEST_MAP_ROWS
        return (
            "" if fits else f"expects a map twice as wide as high, 16x32 to {LARGEST_MAP_ROWS}x{2 * LARGEST_MAP_ROWS}"
        )

    @override
    @torch.no_grad()
    def preview(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Return for fit and reference one picture of the map, the photograph and the second scene, tone-mapped."""
        photo = task.data["photos"][:1]
        return {name: draw_overview(radiance, photo) for name, radiance in self._maps(theta, task).items()}

    @override
    @torch.no_grad()
    def tiles(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Return the photograph if fits see it, and the map and the second scene, tone-mapped, of fit and reference."""
        photo = self.app.sight.show_photo(task)
        tiles = {} if photo is None else {"photo": srgb_to_linear(photo.permute(1, 2, 0))}
        for name, radiance in self._maps(theta, task).items():
            prefix = "" if name == "fit" else f"{name} "
            for title, picture in (("map", radiance), ("relit", relighting.relight(radiance))):
                tiles[f"{prefix}{title}"] = srgb_to_linear(tone_map(picture))[0].permute(1, 2, 0)
        return tiles

    @override
    @torch.no_grad()
    def photo_comparison(self, theta: Params, task: Task) -> PictureComparison | None:
        seen = self.app.sight.gather(stack_tasks(self.app, [task]))
        return self.app.sight.compare_photo(self.app.decoder(add_task_axis(theta)), seen)

    @override
    @torch.no_grad()
    def comparison(self, theta: Params, task: Task) -> PictureComparison | None:
        """Return the second scene under the maps of fit and reference, tone-mapped."""
        lit = {name: tone_map(relighting.relight(radiance)) for name, radiance in self._maps(theta, task).items()}
        return PictureComparison(lit["fit"], lit["reference"]) if "reference" in lit else None

    def _maps(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Return maps [1, 3, H, W] by name: `reference` if it is known, and `fit`."""
        tasks = stack_tasks(self.app, [task])
        truth = self.app.judge.gather(tasks)
        reference = {} if truth is None else {"reference": truth.map}
        return reference | {"fit": self.app.prediction(add_task_axis(theta), self.app.sight.gather(tasks))}

    @override
    @torch.no_grad()
    def pictures(self, theta: Params, task: Task) -> dict[str, Picture]:
        """Return the map and the second scene under it.

        The map has the scale of the task's own file, or a mean luminance of 1 if there was none.
        """
        prediction = self._level(file_map(self.app, theta, task))
        return self.prediction_pictures(prediction, task) | {"map": self.draw_map(theta, task)}

    @override
    @torch.no_grad()
    def linear_maps(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Return the map as its file has it, `radiance` [H, W, 3]."""
        return {"radiance": self.draw_map(theta, task).pixels}

    @override
    @torch.no_grad()
    def prediction_pictures(self, prediction: Tensor, task: Task) -> dict[str, Picture]:
        """Return the map and the second scene under it.

        Args:
            prediction: linear radiance [1, 3, H, W]; the file has its size.
            task: the task.
        """
        maps = normalise_luminance(prediction)
        return {
            "map": radiance_picture(maps, task),
            "relit": Picture(tone_map(relighting.relight(maps))[0].permute(1, 2, 0), "srgb"),
        }

    @torch.no_grad()
    def draw_map(self, theta: Params, task: Task) -> Picture:
        """Return the picture file of the map, of `size` if that is given."""
        app = self.app.resize(*self.size) if self.size else self.app
        return radiance_picture(self._level(file_map(app, theta, task)), task)

    def _level(self, maps: Tensor) -> Tensor:
        """Turn maps [1, 3, H, W] in directions of the camera so that their horizon lies level."""
        return level_maps(maps, math.radians(self.pitch))

    @override
    def remarks(self, theta: Params, task: Task) -> dict[str, object]:
        """State that the map that is fitted is the same everywhere, if it is."""
        notes = uniform_input_remarks(task.data["map"], "radiance (mean luminance 1)") if "map" in task.data else []
        return {"note": "; ".join(notes)} if notes else {}

    @override
    @torch.no_grad()
    def quality_warnings(self, theta: Params, tasks: Tasks) -> list[list[str]]:
        """Warn of a fit that is the same everywhere, where the true map is not."""
        truth = self.app.judge.gather(tasks)
        if truth is None:
            return super().quality_warnings(theta, tasks)
        pairs = zip(self.app.decoder(theta).maps, truth.map, strict=True)
        return [collapsed_fit_warnings(fit, reference) for fit, reference in pairs]

    @override
    def visible(self, task: Task) -> VisibleData:
        return self.app.sight.describe_visible(task)


def file_map(app: Illumination, theta: Params, task: Task) -> Tensor:
    """Return the fitted map [1, 3, H, W] that files show, of mean luminance 1; the task may lack all data.

    Args:
        app: the application, at the size of the map.
        theta: the fit, without a task axis.
        task: the task of the fit, which may hold the light in a mirror ball.
    """
    return app.sight.complete_for_file(app.decoder(add_task_axis(theta)), task)


def radiance_picture(maps: Tensor, task: Task) -> Picture:
    """Return a map [1, 3, H, W] of mean luminance 1 as a picture file, at the scale of the task's own file."""
    return Picture((maps * task.data.get("scale", torch.ones(())))[0].permute(1, 2, 0), "radiance")


def draw_overview(maps: Tensor, photo: Tensor) -> Tensor:
    """Draw a map above the second scene under it, with the photograph in the corner beside that; linear [H, W, 3].

    Args:
        maps: linear radiance [1, 3, H, W].
        photo: the photograph, uint8 [1, 3, S, S].
    """
    scene = tone_map(relighting.relight(maps))[0]
    height, width = scene.shape[1:]
    photo_px = width // 3
    map_picture = interpolate(tone_map(maps), size=(2 * photo_px, 4 * photo_px), mode="nearest")[0]
    column = torch.ones(3, height, photo_px)
    column[:, :photo_px] = avg_pool2d(photo.float() / 255, photo.shape[-1] // photo_px)[0, :, :photo_px, :photo_px]
    pictures = torch.cat([map_picture, torch.cat([scene, column], 2)], 1)
    return srgb_to_linear(pictures).permute(1, 2, 0)
