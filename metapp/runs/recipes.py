"""The recipe that a fit takes if none is named, and whether a recipe can be fitted without a training."""

from __future__ import annotations

from metapp.apps import recipe_of
from metapp.names import recipe_entries
from metapp.storage.shipped import FULL, QUICK, checkpoint_folder


def ships(app: str, recipe: str) -> bool:
    """Return whether checkpoints of a recipe ship: its own, or those of "quick" if it fits the same network."""
    own = recipe == QUICK or checkpoint_folder(app, recipe).is_dir()
    return own or (recipe == FULL and recipe_of(app, FULL).app == recipe_of(app, QUICK).app)


def usual_recipe(app: str) -> str:
    """Return the recipe of a fit that names none: "full", the best rule and size, if it ships, else "quick"."""
    return FULL if FULL in recipe_entries(app) and ships(app, FULL) else QUICK
