"""Stationary svBRDFs on screens and in files: maps that tile, and photographs of them under other lights."""

from __future__ import annotations

import torch
from torch import Tensor

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear, stretched
from metapp.appearance.flash import Maps, relightings
from metapp.appearance.presentation import Compared, Picture
from metapp.appearance.relief import height_from_normal
from metapp.appearance.surface import Surface
from metapp.apps.svbrdf_stationary.app import SvbrdfStationary
from metapp.learning.task import Params, Task
from metapp.networks.presentation import ExemplarPresentation


class SvbrdfStationaryPresentation(ExemplarPresentation[SvbrdfStationary]):
    """Maps of a material like the photographed one, and photographs of them."""

    title = "svBRDF stat."
    measure = "relative L1 distance of Gram matrices in 9 windows, mean over windows, taps and generated materials"

    image_measure = "a photograph of the maps under the exemplar's light and, with references, under three others"

    def outputs(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Photo and fit under the photo's light, then maps and relightings as they are displayed."""
        photo = self.app.exemplar(task.data["image"][None].float() / 255)
        light = self.app.light_of(photo)
        maps, height = self._maps(theta, self.once())
        fit = self.app.photograph(maps, light[0], light[0])
        pictures = {name: picture.pixels for name, picture in self._pictures(maps, height).items()}
        displayed = {"reference": photo[0], "fit": fit} | pictures | {"height": stretched(pictures["height"])[0]}
        return {name: srgb_to_linear(picture).permute(1, 2, 0).expand(-1, -1, 3) for name, picture in displayed.items()}

    @torch.no_grad()
    def compared(self, theta: Params, task: Task) -> Compared:
        """The maps under the photo's light, and under others where the task has references of that."""
        photos = [task.data["image"][None], *([task.data["relit"]] if "relit" in task.data else [])]
        references = torch.cat([self.app.exemplar(each.float() / 255) for each in photos])
        light, maps = self.app.light_of(references[:1])[0], self._maps(theta, self.once())[0]
        pairs = [(light, light), *relightings(device=light.device).values()][: len(references)]
        return Compared(torch.stack([self.app.photograph(maps, *pair) for pair in pairs]), references)

    def files(self, theta: Params, task: Task) -> dict[str, Picture]:
        """Maps that tile, of the size asked for, else four times the exemplar's; photographs under other lights."""
        return _as_files(self._pictures(*self._whole(theta, task)))

    @torch.no_grad()
    def files_of(self, answer: Maps | Tensor, task: Task) -> dict[str, Picture]:
        """The same of the first of the maps [1, B, ...], which tile, of their size; or the first photograph."""
        if not isinstance(answer, Maps):
            return {"photo": Picture(answer[0, 0].permute(1, 2, 0), "srgb")}
        maps = Maps(*(part[0, 0] for part in answer))
        return _as_files(self._pictures(maps, height_from_normal(maps.normal, periodic=True)))

    def surface(self, theta: Params, task: Task) -> Surface:
        """The maps as `files` writes them."""
        maps, height = self._whole(theta, task)
        return Surface(maps.diffuse, True, maps, height)

    def _whole(self, theta: Params, task: Task) -> tuple[Maps, Tensor]:
        return self.kept(theta, task, lambda: self._maps(theta, self.whole()))

    def _maps(self, theta: Params, size: tuple[int, int]) -> tuple[Maps, Tensor]:
        """Maps of one material and their height, without leading axes."""
        maps, heights = self.generated(theta, self.app.maps, size)
        return Maps(*(part[0, 0] for part in maps)), heights[0, 0]

    def _pictures(self, maps: Maps, height: Tensor) -> dict[str, Picture]:
        """Maps, specular colour as F0, and photographs of them under other lights; pixels are [1 or 3, H, W] yet."""
        pictures = {
            "diffuse": Picture(linear_to_srgb(maps.diffuse), "srgb"),
            "specular": Picture(linear_to_srgb(maps.specular), "srgb"),
            "roughness": Picture(maps.roughness, "data"),
            "normal": Picture(maps.normal * 0.5 + 0.5, "data"),
            "height": Picture(height, "height"),
        }
        for name, (light, view) in relightings(device=height.device).items():
            pictures[f"lit_from_{name}"] = Picture(self.app.photograph(maps, light, view), "srgb")
        return pictures


def _as_files(pictures: dict[str, Picture]) -> dict[str, Picture]:
    """Pictures [C, H, W] as files have them, [H, W, C]."""
    return {name: Picture(each.pixels.permute(1, 2, 0), each.kind) for name, each in pictures.items()}
