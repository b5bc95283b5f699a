"""Textures on screens and in files."""

from __future__ import annotations

from torch import Tensor

from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.presentation import Compared, Picture
from metapp.appearance.surface import Surface
from metapp.apps.texture.app import Texture
from metapp.learning.task import Params, Task
from metapp.networks.presentation import ExemplarPresentation


class TexturePresentation(ExemplarPresentation[Texture]):
    """A texture like the exemplar."""

    title = "Texture"
    measure = "relative L1 distance of Gram matrices, mean over taps and generated textures"
    image_measure = "a texture of the exemplar's size beside the exemplar"

    def outputs(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """The exemplar and a texture of its size."""
        texture, exemplar, _ = self.compared(theta, task)
        return {
            "reference": srgb_to_linear(exemplar[0]).permute(1, 2, 0),
            "fit": srgb_to_linear(texture[0]).permute(1, 2, 0),
        }

    def compared(self, theta: Params, task: Task) -> Compared:
        """A texture of the exemplar's size, and the exemplar."""
        exemplar = self.app.exemplar(task.data["image"][None].float() / 255)
        return Compared(self.generated(theta, self.app.generate, self.once())[0], exemplar)

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
