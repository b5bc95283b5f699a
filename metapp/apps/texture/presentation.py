"""Textures on screens and in files."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.features import load_features, sliced_wasserstein
from metapp.appearance.order import lattice_of, order_kept
from metapp.appearance.presentation import Fitted, Picture
from metapp.appearance.surface import Surface
from metapp.apps.texture.app import Texture
from metapp.learning.task import Params, Task
from metapp.networks.presentation import ExemplarPresentation

JUDGING = ("relu2_2", "relu3_3", "relu4_3")  # beside those that fits are compared by


class TexturePresentation(ExemplarPresentation[Texture]):
    """A texture like the exemplar."""

    title = "Texture"
    measure = "relative L1 distance of Gram matrices, mean over taps and generated textures"
    image_measure = (
        "sliced Wasserstein distance of features that no fit is compared by, over their deviation; of exemplars that "
        "repeat, order: the autocorrelation's peaks on their lattice, as high as the exemplar's at 1"
    )

    def outputs(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """The exemplar and a texture of its size."""
        exemplar = self.app.exemplar(task.data["image"][None].float() / 255)[0]
        texture = self.generated(theta, self.app.generate, self.once())[0, 0]
        return {
            "reference": srgb_to_linear(exemplar).permute(1, 2, 0),
            "fit": srgb_to_linear(texture).permute(1, 2, 0),
        }

    @torch.no_grad()
    def image_errors(self, fits: Mapping[str, Fitted], task: Task) -> dict[str, dict[str, float]]:
        """Of a texture of the exemplar's size; `order` where the exemplar has some."""
        exemplar = self.app.exemplar(task.data["image"][None].float() / 255)
        features = load_features(JUDGING, exemplar)
        target, lattice = features(exemplar), lattice_of(exemplar[0])
        measured: dict[str, dict[str, float]] = {}
        for name, fit in fits.items():
            made = self.generated(fit.theta, self.app.generate, self.once())[0]
            distances = [sliced_wasserstein(*pair) for pair in zip(features(made), target, strict=True)]
            measured[name] = {"sliced Wasserstein": float(torch.stack(distances).mean())}
            order = order_kept(lattice, made[0])
            if not math.isnan(order):
                measured[name]["order"] = order
        return measured

    def files(self, theta: Params, task: Task) -> dict[str, Picture]:
        """The texture, of the size asked for, else four times as high and wide as in training; it tiles."""
        return {"texture": Picture(self._whole(theta, task).permute(1, 2, 0), "srgb")}

    def files_of(self, answer: Tensor, task: Task) -> dict[str, Picture]:
        """The first of the textures [1, B, 3, H, W]."""
        return {"texture": Picture(answer[0, 0].permute(1, 2, 0), "srgb")}

    def surface(self, theta: Params, task: Task) -> Surface:
        """The texture as `files` writes it."""
        return Surface(srgb_to_linear(self._whole(theta, task)), True)

    def _whole(self, theta: Params, task: Task) -> Tensor:
        """The texture of the size of files, [3, H, W]."""
        textures: Tensor = self.kept(theta, task, lambda: self.generated(theta, self.app.generate, self.whole()))
        return textures[0, 0]
