"""Options of applications that fit a texture to an exemplar."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from metapp.networks.picture_options import PictureOptions, size
from metapp.options import FIT, Option


@dataclass(frozen=True)
class ExemplarOptions(PictureOptions):
    """The options of applications that fit a texture to an exemplar."""

    size: Annotated[tuple[int, int] | None, size("textures and maps up to 4096x4096")] = None
    detail: Annotated[
        int,
        Option(
            "Resolution at which photos are read and fitted: 256 (the default) or 512, which is four times as slow.",
            "PX",
            low=256,
            panel=FIT,
        ),
    ] = 0

    def adapt_recipe(self, recipe: Any) -> Any:
        """Return the recipe for exemplars of `detail` px a side."""
        from metapp.apps.exemplar.app import set_detail

        return set_detail(recipe, self.detail) if self.detail else recipe
