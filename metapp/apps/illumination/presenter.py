"""Presentation of fitted illumination: maps, a second scene under them, photographed balls, remarks and warnings.

Maps are shown as the application's prediction, at a mean luminance of 1.
"""

from __future__ import annotations

import torch
from torch import Tensor
from typing_extensions import override

from metapp.appearance.colour import srgb_to_linear, tone_map
from metapp.appearance.pictures import PictureComparison
from metapp.appearance.presenter import Presenter
from metapp.appearance.uniform import collapsed_fit_warnings, uniform_input_remarks
from metapp.apps.illumination.app import Illumination
from metapp.apps.illumination.radiance import Radiance
from metapp.learning.app import stack_tasks
from metapp.learning.task import Params, Task, Tasks, add_task_axis

LARGEST_MAP_ROWS = 1024  # rows of the file of a map, at most


class IlluminationPresenter(Presenter[Illumination]):
    """The presenter of fitted environment maps, and of photographed balls, in directions of the camera."""

    picture_measure = "the second scene under the map, tone-mapped"

    @override
    def size_refusal(self, height: int, width: int) -> str:
        fits = 2 * height == width and 16 <= height <= LARGEST_MAP_ROWS
        return (
            "" if fits else f"expects a map twice as wide as high, 16x32 to {LARGEST_MAP_ROWS}x{2 * LARGEST_MAP_ROWS}"
        )

    @override
    @torch.no_grad()
    def shown(self, theta: Params, task: Task) -> Radiance:
        """Return the map of a fit as it is judged."""
        seen = self.app.sight.gather(stack_tasks(self.app, [task]))
        return Radiance(self.app.prediction(add_task_axis(theta), seen)[0])

    @override
    def reference(self, task: Task) -> Radiance | None:
        truth = self.app.judge.gather(stack_tasks(self.app, [task]))
        return None if truth is None else Radiance(truth.map[0])

    @override
    @torch.no_grad()
    def preview(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Return for fit and reference one picture of the map, the photograph and the second scene, tone-mapped."""
        photo, maps = task.data["photos"][0] / 255, self._maps(theta, task)
        return {name: radiance.draw_overview(photo) for name, radiance in maps.items()}

    @override
    @torch.no_grad()
    def tiles(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Return the photograph if fits see it, and the map and the second scene, tone-mapped, of fit and reference."""
        photo = self.app.sight.show_photo(task)
        tiles = {} if photo is None else {"photo": srgb_to_linear(photo.permute(1, 2, 0))}
        for name, radiance in self._maps(theta, task).items():
            prefix = "" if name == "fit" else f"{name} "
            for title, picture in (("map", tone_map(radiance.map)), ("relit", radiance.relight())):
                tiles[f"{prefix}{title}"] = srgb_to_linear(picture).permute(1, 2, 0)
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
        scenes = {name: radiance.relight()[None] for name, radiance in self._maps(theta, task).items()}
        return PictureComparison(scenes["fit"], scenes["reference"]) if "reference" in scenes else None

    def _maps(self, theta: Params, task: Task) -> dict[str, Radiance]:
        """Return maps by name: `reference` if it is known, and `fit`."""
        reference = self.reference(task)
        return ({} if reference is None else {"reference": reference}) | {"fit": self.shown(theta, task)}

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
