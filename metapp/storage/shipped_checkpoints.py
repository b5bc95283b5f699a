"""The files of the checkpoints that ship with the package, one for each application and recipe.

Which recipe a fit takes is decided in `metapp.runs.resolve`, which entry of its file in `metapp.runs.checkpoints`.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path

QUICK_RECIPE_NAME, FULL_RECIPE_NAME = "quick", "full"
CHECKPOINT_PACKAGE = "metapp.checkpoints"  # the package that has the files, one folder an application


def shipped_checkpoint_path(app: str, recipe: str = QUICK_RECIPE_NAME) -> Path:
    """Return the place of the checkpoint that ships for an application and a recipe; there may be none.

    >>> shipped_checkpoint_path("brdf").name
    'quick.safetensors'
    """
    return Path(str(resources.files(CHECKPOINT_PACKAGE))) / app / f"{recipe}.safetensors"


def usable_shipped_checkpoints(app: str, recipe: str) -> list[Path]:
    """Return the files that ship in which a recipe looks for an entry, in this order: its own, of full, of quick.

    >>> [path.stem for path in usable_shipped_checkpoints("brdf", "few")]
    ['few', 'quick']
    """
    recipes = (QUICK_RECIPE_NAME,) if recipe == QUICK_RECIPE_NAME else (recipe, FULL_RECIPE_NAME, QUICK_RECIPE_NAME)
    paths = dict.fromkeys(shipped_checkpoint_path(app, name) for name in recipes)
    return [path for path in paths if path.is_file()]


def shipped_checkpoints(app: str) -> list[Path]:
    """List the files of checkpoints that ship for an application."""
    return sorted(shipped_checkpoint_path(app).parent.glob("*.safetensors"))
