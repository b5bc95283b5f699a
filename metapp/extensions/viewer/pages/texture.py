"""The page of a texture: the fit, the exemplar and one quilted of it, at one scale."""

from __future__ import annotations

import numpy as np
import torch

from metapp.appearance.quilting import block_of, quilted
from metapp.apps.texture.app import Texture
from metapp.extensions.viewer.view import View, thumbnail
from metapp.learning.task import Params, Task

QUILTED = 2  # times as high and wide as the exemplar: what is quilted of it; four times would take six times as long


def view(app: Texture, theta: Params, task: Task) -> View:
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
