"""Options of BRDFs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from metapp.options import FIT, AppOptions, Option


@dataclass(frozen=True)
class BrdfOptions(AppOptions):
    """Whether fits conserve energy."""

    conserve: Annotated[bool, Option("Limit fits to reflecting no more light than they receive.", panel=FIT)] = False

    def adapt_recipe(self, recipe: Any) -> Any:
        """The recipe with fits that reflect no more than all light."""
        from metapp.apps.brdf.energy import set_conservation

        return set_conservation(recipe, self.conserve) if self.conserve else recipe
