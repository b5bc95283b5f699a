"""The presenter of textures: files that tile, comparisons with the exemplar, and warnings.

Warnings about lost structure come from :mod:`metapp.apps.exemplar.presenter`; here are the pictures of fits that they
compare with the exemplar.
"""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor
from typing_extensions import override

from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.pictures import Picture, PictureComparison
from metapp.appearance.surface import Surface
from metapp.apps.exemplar.presenter import ExemplarPresenter
from metapp.apps.texture.app import Texture
from metapp.learning.task import Params, Task, add_task_axis

# Strength of a texture's lines over the exemplar's, below which lines are broken: 5 of 66 fits of photographs
MIN_LINE_STRENGTH = 0.935


@dataclass(frozen=True)
class TexturePresenter(ExemplarPresenter[Texture]):
    """The presenter of a texture that tiles, beside its exemplar."""

    picture_measure = "a texture of the exemplar's size beside the exemplar"
    min_line_strength = MIN_LINE_STRENGTH

    @override
    def preview(self, theta: Params, task: Task) -> dict[str, Tensor]:
        texture, exemplar, _ = self.comparison(theta, task)
        return {
            "reference": srgb_to_linear(exemplar[0]).permute(1, 2, 0),
            "fit": srgb_to_linear(texture[0]).permute(1, 2, 0),
        }

    @override
    def comparison(self, theta: Params, task: Task) -> PictureComparison:
        exemplar = self.app.octaves.take_exemplar(task.data["image"][None].float() / 255)
        return PictureComparison(self.generate_shown(theta, self.app.generate)[0], exemplar)

    @override
    def pictures(self, theta: Params, task: Task) -> dict[str, Picture]:
        return {"texture": Picture(self._texture(theta, task).permute(1, 2, 0), "srgb")}

    @override
    def prediction_pictures(self, prediction: Tensor, task: Task) -> dict[str, Picture]:
        """Return the first one of the textures [1, B, 3, H, W], sRGB in [0, 1]."""
        return {"texture": Picture(prediction[0, 0].permute(1, 2, 0), "srgb")}

    @override
    def surface(self, theta: Params, task: Task) -> Surface:
        return Surface(srgb_to_linear(self._texture(theta, task)), True)

    def _texture(self, theta: Params, task: Task) -> Tensor:
        """Return the texture at the size of files, [3, H, W], sRGB in [0, 1]; it tiles."""
        return self.cache_last(theta, task, lambda: self.app.draw_tile(add_task_axis(theta), task, self.size))
