"""Illumination on screens and in files: maps, and a second scene lit by them."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

from metapp.appearance.colour import srgb_to_linear, tone_map
from metapp.appearance.presentation import Compared, Picture, Visible
from metapp.apps.illumination.app import Illumination
from metapp.apps.illumination.confidence import hatched
from metapp.apps.illumination.spheres import SPHERES
from metapp.apps.illumination.variants import of_mean_1
from metapp.learning.task import Params, Task
from metapp.networks.presentation import CodedPresentation
from metapp.rendering.second_scene import relighting

LARGEST = 1024  # rows of a map


class IlluminationPresentation(CodedPresentation[Illumination]):
    """The map as radiance, and the second scene under it."""

    title = "Illumination"
    measure = "mean absolute error of a second scene's picture under the map"
    measures = {  # noqa: RUF012  (never written to)
        f"{name}_{kind}": f"{name} sphere, {title}"
        for kind, title in (("rmse", "si-RMSE"), ("angle", "degrees"))
        for name in SPHERES
    }
    image_measure = (
        "the second scene under the map; its SSIM after tone mapping; three spheres under the tone-mapped map, as "
        "DiffusionLight's evaluation"
    )
    of_pictures = {  # noqa: RUF012  (never written to)
        "error": "MAE x100",
        "relative": "relative MAE",
        "ssim": "SSIM",
        **measures,
    }

    def refusal(self, height: int, width: int) -> str:
        fits = 2 * height == width and 16 <= height <= LARGEST
        return "" if fits else f"expects a map twice as wide as high, 16x32 to {LARGEST}x{2 * LARGEST}"

    @torch.no_grad()
    def outputs(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Map and second scene, tone-mapped, of the reference, beside the photograph, and of the fit."""
        maps, photo = self._maps(theta, task)
        return {name: shown(each, photo) for name, each in maps.items()}

    @torch.no_grad()
    def compared(self, theta: Params, task: Task) -> Compared | None:
        """The second scene under both maps, tone-mapped."""
        lit = {name: tone_map(relighting.relight(each)) for name, each in self._maps(theta, task)[0].items()}
        return Compared(lit["fit"], lit["reference"]) if "reference" in lit else None

    def _maps(self, theta: Params, task: Task) -> tuple[dict[str, Tensor], Tensor]:
        """The map `reference`, where it is known, and that of the fit, both [1, 3, H, W], and the photograph."""
        prepared = {key: value[None] for key, value in self.app.prepare(task).items()}
        fit = self.app.answer({key: value[None] for key, value in theta.items()}, prepared)
        return ({"reference": prepared["map"]} if "map" in prepared else {}) | {"fit": fit}, prepared["photo"]

    @torch.no_grad()
    def files(self, theta: Params, task: Task) -> dict[str, Picture]:
        """The map, at its file's scale, of mean luminance 1 where there was none, and the second scene under it.

        Of a photograph also the map with stripes where the fit is not sure of it.
        """
        one = {key: value[None] for key, value in theta.items()}
        files = self.files_of(_answer(self.app, one, task), task)
        if self.size:
            files["map"] = self.map_of(one, task)
        if self.app.protocol == "photo":
            spread = self.app.spread(one, {key: value[None] for key, value in self.app.prepare(task).items()})
            light = files["map"].pixels.permute(2, 0, 1)
            files["confidence"] = Picture(hatched(tone_map(light / light.mean()), spread).permute(1, 2, 0), "srgb")
        return files

    @torch.no_grad()
    def maps(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """The map as `files` writes it."""
        answer = _answer(self.app, {key: value[None] for key, value in theta.items()}, task)
        return {"radiance": _radiance(of_mean_1(answer), task).pixels}

    @torch.no_grad()
    def files_of(self, answer: Tensor, task: Task) -> dict[str, Picture]:
        """The same of a map [1, 3, H, W], of its size."""
        maps = of_mean_1(answer)
        return {
            "map": _radiance(maps, task),
            "relit": Picture(tone_map(relighting.relight(maps))[0].permute(1, 2, 0), "srgb"),
        }

    def map_of(self, theta: Params, task: Task) -> Picture:
        """The map of `files`, of parameters [1, ...] of one task."""
        return _radiance(_answer(self.app.sized(*self.size) if self.size else self.app, theta, task), task)

    def visible(self, task: Task) -> Visible:
        """The map or the photograph, all of it in each step; General's encoder reads the photograph alone."""
        if self.app.protocol == "photo":
            return Visible(1, task.data["photos"][0].nbytes, 1)
        return Visible(1, task.data["map"].nbytes, 0)


def _answer(app: Illumination, theta: Params, task: Task) -> Tensor:
    return app.answer(theta, {key: value[None] for key, value in app.mirrored(task).items()})


def _radiance(maps: Tensor, task: Task) -> Picture:
    return Picture((maps * task.data.get("scale", torch.ones(())))[0].permute(1, 2, 0), "radiance")


def shown(maps: Tensor, photo: Tensor) -> Tensor:
    """One linear picture: the map above the second scene, and the photograph in the corner beside that."""
    lit = tone_map(relighting.relight(maps))[0]
    height, width = lit.shape[1:]
    across = width // 3
    whole = interpolate(tone_map(maps), size=(2 * across, 4 * across), mode="nearest")[0]
    column = torch.ones(3, height, across)
    column[:, :across] = avg_pool2d(photo.float() / 255, photo.shape[-1] // across)[0, :, :across, :across]
    pictures = torch.cat([whole, torch.cat([lit, column], 2)], 1)
    return srgb_to_linear(pictures).permute(1, 2, 0)
