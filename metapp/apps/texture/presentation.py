"""Textures on screens and in files."""

from __future__ import annotations

from typing import Any

from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.presentation import Picture
from metapp.appearance.surface import Surface
from metapp.apps.texture import Texture
from metapp.learning.task import Params, Task
from metapp.networks.presentation import TILED, ExemplarPresentation


class TexturePresentation(ExemplarPresentation[Texture]):
    """A texture like the exemplar."""

    title = "Texture"
    measure = "relative L1 distance of Gram matrices, mean over taps and generated textures"

    def outputs(self, theta: Params, task: Task) -> dict[str, Any]:
        """The exemplar and a texture of its size."""
        exemplar = self.app.exemplar(task.data["image"][None].float() / 255)[0]
        made = self.made(theta, self.app.generate, 1)[0, 0]
        return {
            "reference": srgb_to_linear(exemplar).permute(1, 2, 0),
            "fit": srgb_to_linear(made).permute(1, 2, 0),
        }

    def files(self, theta: Params, task: Task) -> dict[str, Picture]:
        """The texture, four times as high and wide as in training; it tiles."""
        return {"texture": Picture(self.made(theta, self.app.generate, TILED)[0, 0].permute(1, 2, 0), "srgb")}

    def surface(self, theta: Params, task: Task) -> Surface:
        """The texture as `files` writes it."""
        return Surface(srgb_to_linear(self.made(theta, self.app.generate, TILED)[0, 0]), True)


PRESENTATION = TexturePresentation
