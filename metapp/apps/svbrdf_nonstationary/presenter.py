"""The presenter of non-stationary svBRDFs: maps, pictures of them under flashes and other lights, and warnings.

One presenter serves fits of maps, of one photograph and of several: it gets maps and flashes from the decoder, and asks
the sight what fits saw.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, interpolate
from typing_extensions import override

from metapp.appearance.colour import linear_to_srgb, radiance_to_display, srgb_to_linear
from metapp.appearance.flash import camera_position
from metapp.appearance.pictures import Picture, PictureComparison, VisibleData
from metapp.appearance.presenter import Presenter
from metapp.appearance.surface import Surface, map_pictures, photograph_maps, scale_relief
from metapp.appearance.svbrdf_maps import Maps, unpack_maps
from metapp.apps.svbrdf_nonstationary.app import FINEST_PX, SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.flashes import Flash, photograph_by
from metapp.apps.svbrdf_nonstationary.map_judge import RADIANCE_FLOOR, judged_log_radiance
from metapp.apps.svbrdf_nonstationary.maps import decode_photo, pool_maps, scale_size
from metapp.learning.app import stack_tasks
from metapp.learning.task import Params, Task, Tasks, add_task_axis

LARGEST_PX = 4096  # longest side of maps in files
SHOWN_PX = 256  # longest side of maps that are shown


@dataclass(frozen=True)
class SvbrdfNonstationaryPresenter(Presenter[SvbrdfNonstationary]):
    """The presenter of maps of a flat material: with photographs as the fit sees them, and under other lights.

    Attributes:
        relief: the factor of slopes of normals in files and pictures; errors are without it.
    """

    relief: float = 1.0
    picture_measure = "renderings under 12 other lights, at gamma 2.2"

    @override
    def size_refusal(self, height: int, width: int) -> str:
        is_possible = height == width and 32 <= height <= LARGEST_PX
        return "" if is_possible else f"expects square maps of 32 to {LARGEST_PX} px, as photos are cut to a square"

    @override
    @torch.no_grad()
    def preview(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Return four maps above pictures of them under the flash and three other lights, beside the true ones."""
        maps, photo = self._small_maps(theta, task)
        reference = {}
        if "maps" in task.data:
            reference = {"reference": _draw_sheet(unpack_maps(pool_maps(task.data["maps"].float(), photo.shape[-2:])))}
        return reference | {"fit": _draw_sheet(scale_relief(maps, self.relief))}

    @override
    @torch.no_grad()
    def tiles(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Return the photograph, the fit under its flash, maps, and the fit under three other lights."""
        comparison, (maps, photo) = self.photo_comparison(theta, task), self._small_maps(theta, task)
        eye = camera_position()
        fitted_photo = photograph_maps(maps, eye, eye) if comparison is None else comparison.pictures[0]
        tiles = {"photo": photo[0].permute(1, 2, 0), "fit": srgb_to_linear(fitted_photo).permute(1, 2, 0)}
        tiles |= _draw_linear_maps(scale_relief(maps, self.relief))
        if "maps" in task.data:
            target = _draw_linear_maps(unpack_maps(pool_maps(task.data["maps"].float(), photo.shape[-2:])))
            tiles |= {f"reference {name}": picture for name, picture in target.items()}
        return tiles

    @override
    @torch.no_grad()
    def pictures(self, theta: Params, task: Task) -> dict[str, Picture]:
        """Return the maps, of the size asked for, else of the photograph's, and pictures under three other lights.

        Fits of several photographs also have `photo_1` and so on: the maps as each photograph shows them.
        """
        maps = self._shown_maps(theta, task)
        pictures = map_pictures(scale_relief(maps, self.relief))
        if names := self.app.sight.picture_names(task):
            for name, flash in zip(names, self.flashes(theta, task), strict=True):
                radiance = photograph_by(flash, Maps(*(part[None] for part in maps)))
                pictures[name] = Picture(linear_to_srgb(radiance.clamp(0, 1)).permute(1, 2, 0), "srgb")
        return pictures

    @override
    def prediction_pictures(self, prediction: Maps, task: Task) -> dict[str, Picture]:
        """Return the pictures of maps [1, C, H, W], of their size."""
        return map_pictures(Maps(*(part[0] for part in prediction)))

    @override
    @torch.no_grad()
    def surface(self, theta: Params, task: Task) -> Surface:
        maps = scale_relief(self._shown_maps(theta, task), self.relief)
        return Surface(maps.diffuse, False, maps)

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
        pair = self.app.rerender_photos(theta, task, min(SHOWN_PX, *task.data["photo"].shape[-2:]))
        if pair is None:
            return None
        return PictureComparison(*(linear_to_srgb(pictures.clamp(0, 1)) for pictures in pair))

    @override
    @torch.no_grad()
    def remarks(self, theta: Params, task: Task) -> Mapping[str, object]:
        """Return the remarks of the sight on the fit; `mean_tilt_degrees` is without the factor `relief`."""
        return self.app.sight.fit_remarks(self.app.decode(theta, task, _small_photo(task)), task)

    @override
    @torch.no_grad()
    def quality_warnings(self, theta: Params, tasks: Tasks) -> list[list[str]]:
        seen = self.app.sight.gather(tasks)
        return self.app.sight.quality_warnings(self.app.decoder(theta, seen), seen)

    @override
    def visible(self, task: Task) -> VisibleData:
        return self.app.sight.describe_visible(task)

    @torch.no_grad()
    def flashes(self, theta: Params, task: Task) -> list[Flash]:
        """Return the flash of each photograph, without axes, as the fit, without a task axis, places it."""
        flashes: list[Flash] = self.app.decode(theta, task, _small_photo(task)).flash_of_each_photo()
        return flashes

    def _small_maps(self, theta: Params, task: Task) -> tuple[Maps, Tensor]:
        """Return maps [C, h, w] of at most SHOWN_PX a side, as fitted, and the linear photograph [1, 3, h, w]."""
        photo = _small_photo(task)
        maps = self.app.sight.fill(self.app.decode(theta, task, photo), photo)
        return Maps(*(part[0] for part in maps)), photo

    def _shown_maps(self, theta: Params, task: Task) -> Maps:
        """Return the maps [C, H, W] of the size of files, as fitted."""
        shorter = min(task.data["photo"].shape[-2:])
        side = self.size[0] if self.size else min(self.app.read_size or FINEST_PX, shorter)

        def make() -> Maps:
            photo = _resize_photo(task, side)
            return self.app.sight.fill(self.app.decode(theta, task, photo), photo)

        maps = self.cache_last(theta, task, make)
        return Maps(*(part[0] for part in maps))


def _resize_photo(task: Task, shorter: int) -> Tensor:
    """Return the photograph, linear [1, 3, h, w]: means over areas; a smaller one is interpolated.

    Args:
        task: the task.
        shorter: the shorter side of the result, in px.
    """
    photo = decode_photo(task.data["photo"])[None]
    size = scale_size(photo, shorter)
    enlarges = size[0] > photo.shape[-2]
    return interpolate(photo, size=size, mode="bilinear") if enlarges else adaptive_avg_pool2d(photo, size)


def _small_photo(task: Task) -> Tensor:
    """Return the photograph, linear [1, 3, h, w], whose shorter side has at most SHOWN_PX."""
    return _resize_photo(task, min(SHOWN_PX, *task.data["photo"].shape[-2:]))


def _draw_linear_maps(maps: Maps) -> dict[str, Tensor]:
    """Return the pictures that `map_pictures` makes of maps [C, H, W], linear [H, W, 3]."""
    return {name: srgb_to_linear(picture.pixels).expand(-1, -1, 3) for name, picture in map_pictures(maps).items()}


def _draw_sheet(maps: Maps) -> Tensor:
    """Return a linear picture [2 H, 4 W, 3] of maps [C, H, W]: four maps; below, the flash and three other lights."""
    pictures, eye = map_pictures(maps), camera_position(device=maps.diffuse.device)
    flash = photograph_maps(maps, eye, eye).permute(1, 2, 0)
    map_row = [pictures.pop(name).pixels.expand(-1, -1, 3) for name in ("normal", "diffuse", "roughness", "specular")]
    light_row = [flash, *(picture.pixels for picture in pictures.values())]
    return srgb_to_linear(torch.cat([torch.cat(row, 1) for row in (map_row, light_row)]))
