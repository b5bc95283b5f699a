"""The presenter of textures: comparisons with the exemplar, and warnings.

Warnings about lost structure come from :mod:`metapp.apps.exemplar.presenter`; here are the pictures of fits that they
compare with the exemplar.
"""

from __future__ import annotations

from typing_extensions import override

from metapp.appearance.assets import Texture
from metapp.appearance.pictures import PictureComparison
from metapp.apps.exemplar.presenter import ExemplarPresenter
from metapp.learning.task import Params, Task


class TexturePresenter(ExemplarPresenter):
    """The presenter of a texture that tiles, beside its exemplar."""

    picture_measure = "a texture of the exemplar's size beside the exemplar"

    @override
    def shown(self, theta: Params, task: Task) -> Texture:
        """Return the texture at the exemplar's size."""
        return Texture(self.generate_shown(theta).prediction[0, 0])

    @override
    def reference(self, task: Task) -> Texture:
        return Texture(self.app.sight.take_exemplar(task)[0], tiles=False)

    @override
    def comparison(self, theta: Params, task: Task) -> PictureComparison:
        return PictureComparison(self.shown(theta, task).pixels[None], self.reference(task).pixels[None])
