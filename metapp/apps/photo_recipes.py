"""The recipes of an application with fits of the thing itself, and with fits of one photograph of it.

Two applications have such tables, which differ in their networks and in how they are trained.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from metapp.learning.app import App
from metapp.learning.recipe import Recipe, paper_recipe


def recipes_of_references_and_photos(
    quick: Recipe, photo: Recipe, *, full: Sequence[App], paper: Sequence[App]
) -> tuple[dict[str, Recipe], dict[str, Recipe]]:
    """Return recipes "paper", "quick" and "full" by name: of fits of the thing itself, and of fits of one photograph.

    Args:
        quick: the recipe "quick" of fits that see the thing itself.
        photo: the recipe "quick" of fits that see one photograph, of equal size.
        full, paper: the application at the size that people use, and at the paper's, for both kinds of fits.
    """
    published = paper_recipe(quick, paper[0])
    photo_paper = replace(
        published, app=paper[1], overfit=photo.overfit, finetune=photo.finetune, quickft=photo.quickft
    )
    return (
        {"paper": published, "quick": quick, "full": replace(quick, app=full[0])},
        {"paper": photo_paper, "quick": photo, "full": replace(photo, app=full[1])},
    )
