"""The presenter of textures: files that tile, comparisons with the exemplar, and warnings.

Warnings about lost structure come from :mod:`metapp.apps.exemplar.presenter`; here are the pictures of fits that they
compare with the exemplar.
"""

from __future__ import annotations

from dataclasses import dataclass

from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.pictures import Picture, PictureComparison
from metapp.appearance.surface import Surface
from metapp.apps.exemplar.presenter import SHOWN_SEED, ExemplarPresenter
from metapp.apps.texture.app import Texture
from metapp.learning.random_tensors import draw_normal
from metapp.learning.task import Params, Task

# Strength of a texture's lines over the exemplar's. Chosen by fits of 66 photographs that were graded by eye; on every
# other one of them, 9 of 12 broken textures are below it, and 1 of 11 intact ones.
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
    def answer_pictures(self, answer: Tensor, task: Task) -> dict[str, Picture]:
        """Return the first one of the textures [1, B, 3, H, W], sRGB in [0, 1]."""
        return {"texture": Picture(answer[0, 0].permute(1, 2, 0), "srgb")}

    @override
    def surface(self, theta: Params, task: Task) -> Surface:
        return Surface(srgb_to_linear(self._texture(theta, task)), True)

    def _texture(self, theta: Params, task: Task) -> Tensor:
        """Return the texture at the size of files, [3, H, W], sRGB in [0, 1]; it tiles."""

        def make() -> Tensor:
            return self.generate_shown(theta, self.app.generate, self.picture_size)

        return self.cache_last(theta, task, make)[0, 0]

    @override
    def pictures_for_lines(self, theta: Params, pictures: Tensor) -> Tensor:
        """Generate textures of twice the exemplar's size, [T, 3, 2 H, 2 W].

        Layouts are quilted anew for these, as for files, which breaks lines more often than the exemplar's size.
        """
        rng, (height, width) = Generator(pictures.device).manual_seed(SHOWN_SEED), pictures.shape[-2:]
        noise = draw_normal(rng, 1, 1, self.app.network.noise, 2 * height, 2 * width)
        return self.app.generate(theta, noise.expand(len(pictures), -1, -1, -1, -1))[:, 0]
