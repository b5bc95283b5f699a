"""The recipe of a fit that names none, and whether checkpoints of a recipe ship, so that it needs no training.

Only names and files are looked at; which recipe suits the inputs is chosen in `metapp.runs.recipe_choice`.
"""

from __future__ import annotations

from metapp.apps import recipe_of
from metapp.names import recipe_entries
from metapp.storage.shipped_checkpoints import FULL_RECIPE_NAME, QUICK_RECIPE_NAME, checkpoint_folder


def has_shipped_recipe(app: str, recipe: str) -> bool:
    """Return whether checkpoints ship by which a recipe can fit.

    The recipe "full" needs none for itself where its application has the network of the recipe "quick".
    """
    has_checkpoints = recipe == QUICK_RECIPE_NAME or checkpoint_folder(app, recipe).is_dir()
    return has_checkpoints or (
        recipe == FULL_RECIPE_NAME and recipe_of(app, FULL_RECIPE_NAME).app == recipe_of(app, QUICK_RECIPE_NAME).app
    )


def usual_recipe(app: str) -> str:
    """Return the recipe of a fit that names none: "full" (the best rule and size) if it ships, else "quick"."""
    return (
        FULL_RECIPE_NAME
        if FULL_RECIPE_NAME in recipe_entries(app) and has_shipped_recipe(app, FULL_RECIPE_NAME)
        else QUICK_RECIPE_NAME
    )
