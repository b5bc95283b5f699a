"""The surface that fits of non-stationary svBRDFs answer with: maps at the size of files, and their photographs."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, interpolate

from metapp.appearance.assets import Photograph, Surface
from metapp.appearance.svbrdf_maps import Maps, unpack_maps
from metapp.apps.svbrdf_nonstationary.app import FINEST_PX, SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.maps import decode_photo, scale_size
from metapp.learning.task import Params, Task


@torch.no_grad()
def make_surface(app: SvbrdfNonstationary, theta: Params, task: Task, size: tuple[int, int] | None) -> Surface:
    """Return the maps of a fit, of the photograph's size by default; see :class:`metapp.application.MakeAsset`."""
    shorter = min(task.data["photo"].shape[-2:])
    return surface_at(app, theta, task, size[0] if size else min(app.read_size or FINEST_PX, shorter))


@torch.no_grad()
def surface_at(app: SvbrdfNonstationary, theta: Params, task: Task, shorter: int) -> Surface:
    """Return the maps of a fit, and the photographs that it saw, as they were taken.

    Args:
        app: the application.
        theta: the parameters of the fit, without a task axis.
        task: the task that was fitted, with its photographs.
        shorter: the shorter side of the maps in texels.
    """
    photo = resize_photo(task, shorter)
    answer = app.decode(theta, task, photo)
    maps = app.sight.fill(answer, photo)
    photos = app.sight.photos(task)
    flashes = answer.flash_of_each_photo()
    # fits of maps see no photograph: theirs was rendered from the maps
    pixels = [None] * len(flashes) if photos is None else [*photos][: len(flashes)]
    return Surface(
        Maps(*(part[0] for part in maps)),
        tiles=False,
        photos={
            f"photo_{number}": Photograph(flash.place, flash.eye, flash.gain, flash.falloff, -flash.place, photo_pixels)
            for number, (flash, photo_pixels) in enumerate(zip(flashes, pixels, strict=True), 1)
        },
        lit_photos=app.sight.lit_photos(task),
    )


def true_surface(task: Task) -> Surface | None:
    """Return the true maps of a task, as fine as they are known; None if they are not known."""
    return Surface(unpack_maps(task.data["maps"].float()), tiles=False) if "maps" in task.data else None


def resize_photo(task: Task, shorter: int) -> Tensor:
    """Return the photograph, linear [1, 3, h, w]: means over areas; a smaller one is interpolated.

    Args:
        task: the task.
        shorter: the shorter side of the result, in px.
    """
    photo = decode_photo(task.data["photo"])[None]
    size = scale_size(photo, shorter)
    enlarges = size[0] > photo.shape[-2]
    return interpolate(photo, size=size, mode="bilinear") if enlarges else adaptive_avg_pool2d(photo, size)
