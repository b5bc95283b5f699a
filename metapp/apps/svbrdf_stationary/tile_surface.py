"""The surface that fits of stationary svBRDFs answer with: maps that tile, and the flash photograph."""

from __future__ import annotations

import torch

from metapp.appearance.assets import Photograph, Surface
from metapp.appearance.colour import DISPLAY_GAMMA
from metapp.apps.svbrdf_stationary.app import SvbrdfStationary
from metapp.apps.svbrdf_stationary.flash_statistics import FLASH_FALLOFF
from metapp.learning.task import Params, Task, add_task_axis


@torch.no_grad()
def make_surface(app: SvbrdfStationary, theta: Params, task: Task, size: tuple[int, int] | None) -> Surface:
    """Return the maps of a fit, which tile; see :class:`metapp.application.MakeAsset`."""
    maps, height = app.draw_maps(add_task_axis(theta), task, size)
    photos = {}
    if "image" in task.data:
        photo = app.sight.take_exemplar(task)
        light, share = app.judge.find_light(photo)[0], app.photo_share(task, size)
        photos["photo_1"] = Photograph(light, light, pixels=photo[0] ** DISPLAY_GAMMA, shown_share=share)
    return Surface(maps, True, height, FLASH_FALLOFF, photos)
