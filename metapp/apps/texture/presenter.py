"""The presenter of textures: comparisons with the exemplar, and warnings.

Warnings about lost structure come from :mod:`metapp.apps.exemplar.presenter`; here are the pictures of fits that they
compare with the exemplar.
"""

from __future__ import annotations

from torch import Tensor
from typing_extensions import override

from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.pictures import PictureComparison
from metapp.apps.exemplar.presenter import ExemplarPresenter
from metapp.learning.task import Params, Task


class TexturePresenter(ExemplarPresenter):
    """The presenter of a texture that tiles, beside its exemplar."""

    picture_measure = "a texture of the exemplar's size beside the exemplar"

    @override
    def preview(self, theta: Params, task: Task) -> dict[str, Tensor]:
        texture, exemplar, _ = self.comparison(theta, task)
        return {
            "reference": srgb_to_linear(exemplar[0]).permute(1, 2, 0),
            "fit": srgb_to_linear(texture[0]).permute(1, 2, 0),
        }

    @override
    def comparison(self, theta: Params, task: Task) -> PictureComparison:
        return PictureComparison(self.generate_shown(theta).prediction[0], self.app.sight.take_exemplar(task))
