"""Options of applications that generate pictures with the statistics of an exemplar.

Help and completion read this module, so it imports nothing large before an option takes effect.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from typing_extensions import override

from metapp.networks.picture_options import PictureOptions, size_option
from metapp.options import FIT, Option


@dataclass(frozen=True)
class ExemplarOptions(PictureOptions):
    """The options of textures, and of other pictures like an exemplar: their size, and the exemplar's resolution."""

    size: Annotated[tuple[int, int] | None, size_option("textures and maps up to 4096x4096")] = None
    detail: Annotated[
        int,
        Option(
            "Resolution at which photos are read and fitted: 256 (the default) or 512, which is four times as slow.",
            "PX",
            low=256,
            panel=FIT,
        ),
    ] = 0

    @override
    def adapt_recipe(self, recipe: Any) -> Any:
        """Return the recipe for exemplars of `detail` px a side, if that is given."""
        from metapp.apps.exemplar.app import set_detail

        return set_detail(recipe, self.detail) if self.detail else recipe
