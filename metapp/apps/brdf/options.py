"""The options of the application brdf. Help and completion read this module, so it imports nothing large."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from typing_extensions import override

from metapp.options import FIT, AppOptions, Option


@dataclass(frozen=True)
class BrdfOptions(AppOptions):
    """The option of BRDFs: whether fits conserve energy."""

    conserve: Annotated[bool, Option("Limit fits to reflecting no more light than they receive.", panel=FIT)] = False

    @override
    def adapt_recipe(self, recipe: Any) -> Any:
        from metapp.apps.brdf.energy import set_conservation

        return set_conservation(recipe, self.conserve) if self.conserve else recipe
