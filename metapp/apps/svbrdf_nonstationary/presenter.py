"""The presenter of non-stationary svBRDFs: maps, pictures of them under flashes and other lights, and warnings.

One presenter serves fits of maps, of one photograph and of several: it gets maps and flashes from the decoder, and asks
the sight what fits saw.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor
from typing_extensions import override

from metapp.appearance.assets import Surface
from metapp.appearance.colour import linear_to_srgb, radiance_to_display, srgb_to_linear
from metapp.appearance.pictures import PictureComparison
from metapp.appearance.presenter import Presenter
from metapp.appearance.surface import map_pictures
from metapp.appearance.svbrdf_maps import unpack_maps
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.map_judge import RADIANCE_FLOOR, judged_log_radiance
from metapp.apps.svbrdf_nonstationary.maps import pool_maps, scale_size
from metapp.apps.svbrdf_nonstationary.material_surface import resize_photo, surface_at
from metapp.learning.app import stack_tasks
from metapp.learning.task import Params, Task, Tasks, add_task_axis

LARGEST_PX = 4096  # longest side of maps in files
SHOWN_PX = 256  # longest side of maps that are shown


class SvbrdfNonstationaryPresenter(Presenter[SvbrdfNonstationary]):
    """The presenter of maps of a flat material: with photographs as the fit sees them, and under other lights."""

    picture_measure = "renderings under 12 other lights, at gamma 2.2"

    @override
    def size_refusal(self, height: int, width: int) -> str:
        is_possible = height == width and 32 <= height <= LARGEST_PX
        return "" if is_possible else f"expects square maps of 32 to {LARGEST_PX} px, as photos are cut to a square"

    @override
    def shown(self, theta: Params, task: Task) -> Surface:
        """Return the maps of a fit, with a shorter side of at most SHOWN_PX."""
        surface: Surface = self.options.adapt_asset(surface_at(self.app, theta, task, self._shown_side(task)))
        return surface

    @override
    def reference(self, task: Task) -> Surface | None:
        if "maps" not in task.data:
            return None
        size = scale_size(task.data["photo"], self._shown_side(task))
        return Surface(unpack_maps(pool_maps(task.data["maps"].float(), size)), tiles=False)

    @override
    @torch.no_grad()
    def preview(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Return four maps above pictures of them under the flash and three other lights, beside the true ones."""
        surfaces = {"reference": self.reference(task), "fit": self.shown(theta, task)}
        return {name: draw_sheet(surface) for name, surface in surfaces.items() if surface is not None}

    @override
    @torch.no_grad()
    def tiles(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Return the photograph, the fit under its flash, maps, and the fit under three other lights."""
        comparison, reference = self.photo_comparison(theta, task), self.reference(task)
        photo = resize_photo(task, self._shown_side(task))[0].permute(1, 2, 0)
        if comparison is None:
            fit = surface_at(self.app, theta, task, self._shown_side(task)).preview()
        else:
            fit = srgb_to_linear(comparison.pictures[0]).permute(1, 2, 0)
        tiles = {"photo": photo, "fit": fit, **_draw_linear_maps(self.shown(theta, task))}
        if reference is not None:
            tiles |= {f"reference {name}": picture for name, picture in _draw_linear_maps(reference).items()}
        return tiles

    @override
    @torch.no_grad()
    def comparison(self, theta: Params, task: Task) -> PictureComparison | None:
        """Return the renderings that errors are of, as displays of gamma 2.2 show them."""
        tasks = stack_tasks(self.app, [task])
        truth = self.app.judge.gather(tasks)
        if truth is None:
            return None
        fitted_maps = self.app.prediction(add_task_axis(theta), self.app.sight.gather(tasks))
        log_pictures = (judged_log_radiance(maps)[0] for maps in (fitted_maps, unpack_maps(truth.maps)))
        return PictureComparison(*(radiance_to_display(logs.exp() - RADIANCE_FLOOR) for logs in log_pictures))

    @override
    @torch.no_grad()
    def photo_comparison(self, theta: Params, task: Task) -> PictureComparison | None:
        """Return what the fit says of each photograph, of at most SHOWN_PX a side."""
        pair = self.app.rerender_photos(theta, task, self._shown_side(task))
        if pair is None:
            return None
        return PictureComparison(*(linear_to_srgb(pictures.clamp(0, 1)) for pictures in pair))

    @override
    @torch.no_grad()
    def remarks(self, theta: Params, task: Task) -> Mapping[str, object]:
        """Return the remarks of the sight on the fit; `mean_tilt_degrees` is without the factor `relief`."""
        photo = resize_photo(task, self._shown_side(task))
        return self.app.sight.fit_remarks(self.app.decode(theta, task, photo), task)

    @override
    @torch.no_grad()
    def quality_warnings(self, theta: Params, tasks: Tasks) -> list[list[str]]:
        seen = self.app.sight.gather(tasks)
        return self.app.sight.quality_warnings(self.app.decoder(theta, seen), seen)

    def _shown_side(self, task: Task) -> int:
        """Return the shorter side of maps and photographs that are shown, in px."""
        height, width = task.data["photo"].shape[-2:]
        return min(SHOWN_PX, height, width)


def _draw_linear_maps(surface: Surface) -> dict[str, Tensor]:
    """Return the pictures of the maps of a surface, and of it under other lights, linear [H, W, 3]."""
    pictures = map_pictures(surface.maps)
    return {name: srgb_to_linear(picture.pixels).expand(-1, -1, 3) for name, picture in pictures.items()}


def draw_sheet(surface: Surface) -> Tensor:
    """Return a linear picture [2 H, 4 W, 3]: four maps; below, the surface under a flash and three other lights."""
    pictures = _draw_linear_maps(surface)
    map_row = [pictures.pop(name) for name in ("normal", "diffuse", "roughness", "specular")]
    return torch.cat([torch.cat(row, 1) for row in (map_row, [surface.preview(), *pictures.values()])])
