"""The pages of flat materials: maps in their photographs and under other lights, textures beside their exemplars."""

from __future__ import annotations

import numpy as np
import torch

from metapp.appearance.flash import GAMMA, unpack
from metapp.appearance.quilting import block_of, quilted
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.maps import linear
from metapp.apps.svbrdf_stationary.app import FALLOFF, SvbrdfStationary
from metapp.apps.texture.app import Texture
from metapp.extensions.viewer.surface import Lit, surface_view
from metapp.extensions.viewer.view import View, thumbnail
from metapp.learning.task import Params, Task

QUILTED = 2  # times as high and wide as the exemplar: what is quilted of it; four times would take six times as long


@torch.no_grad()
def svbrdf_nonstationary(app: SvbrdfNonstationary, theta: Params, task: Task) -> View:
    """The maps as `pictures` has them, the photographs, and the true maps where the task has them."""
    flashes = app.flashes(theta, task)
    photos = [task.data["photo"], *task.data.get("others", ())][: len(flashes)]
    taken = app.protocol == "photo"  # else the photo was rendered from the maps
    photographed = [
        Lit(flash.place, flash.eye, float(flash.gain), linear(photo) if taken else None)
        for flash, photo in zip(flashes, photos, strict=True)
    ]
    reference = unpack(task.data["maps"].float()) if "maps" in task.data else None
    return surface_view(app.surface(theta, task), photographed, reference=reference)


def svbrdf_stationary(app: SvbrdfStationary, theta: Params, task: Task) -> View:
    """The maps as `pictures` has them, and the photograph where it is at hand."""
    photographed = []
    if "image" in task.data:
        photo = app.exemplar(task.data["image"][None].float() / 255)
        light, part = app.light_of(photo)[0], app.width / app.picture_size[1]
        photographed = [Lit(light, light, photo=photo[0] ** GAMMA, part=part)]
    return surface_view(app.surface(theta, task), photographed, falloff=FALLOFF)


def texture(app: Texture, theta: Params, task: Task) -> View:
    """The texture as `pictures` has it, the exemplar where it is at hand, and one quilted of that, at one scale."""
    fit = app.pictures(theta, task)["texture"].pixels
    pictures, tiles = {"fit": fit}, {"exemplar": "seams", "fit": "whole", "image quilting": "seams"}
    if "image" in task.data:
        exemplar = pictures["exemplar"] = app.exemplar(task.data["image"][None].float() / 255)[0].permute(1, 2, 0)
        pixels, size = exemplar.numpy(), (QUILTED * exemplar.shape[0], QUILTED * exemplar.shape[1])
        block, overlap = block_of(pixels)
        made = quilted(pixels, size, np.random.default_rng(0), block=block, overlap=overlap)  # the same each time
        pictures["image quilting"] = torch.from_numpy(made)
    rows = [{"title": name, "name": name, "tiles": how} for name, how in tiles.items() if name in pictures]
    facts = {"pictures": rows, "compared": [rows[0]["title"], "fit"]}
    return View("pictures", pictures=pictures, facts=facts, thumbnail=thumbnail(fit))
