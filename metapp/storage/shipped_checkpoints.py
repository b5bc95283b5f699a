"""Where the checkpoints lie that ship with the package.

Applications and runs ask for them by name; which recipe is the usual one is decided in `metapp.runs.default_recipe`.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path

QUICK_RECIPE_NAME, FULL_RECIPE_NAME = "quick", "full"
CHECKPOINT_PACKAGE = "metapp.checkpoints"


def shipped_checkpoint_path(app: str, name: str, recipe: str = QUICK_RECIPE_NAME) -> Path:
    """Return the path of a checkpoint that ships.

    Checkpoints that a recipe does not share with "full" and "quick" lie in a folder of the recipe's name.

    Args:
        app: the application.
        name: the file's name without suffix, such as "general-photo".
        recipe: the recipe that fits.

    >>> shipped_path("brdf", "general").name
    'general.safetensors'
    """
    folders = (
        [checkpoint_folder(app, recipe), checkpoint_folder(app, FULL_RECIPE_NAME)]
        if recipe != QUICK_RECIPE_NAME
        else []
    )
    files = [folder / f"{name}.safetensors" for folder in (*folders, checkpoint_folder(app))]
    return next((path for path in files if path.is_file()), files[-1])


def shipped_checkpoint_names(app: str) -> dict[str, list[str]]:
    """List the checkpoints that ship for an application, by it, and for its recipe of another size, by "<app> full"."""
    folders = {app: checkpoint_folder(app), f"{app} {FULL_RECIPE_NAME}": checkpoint_folder(app, FULL_RECIPE_NAME)}
    names = {key: sorted(path.stem for path in folder.glob("*.safetensors")) for key, folder in folders.items()}
    return {key: found for key, found in names.items() if found or key == app}


def checkpoint_folder(app: str, recipe: str = QUICK_RECIPE_NAME) -> Path:
    """Return the folder of the checkpoints of an application, or of those that one recipe alone has."""
    folder = Path(str(resources.files(CHECKPOINT_PACKAGE))) / app
    return folder if recipe == QUICK_RECIPE_NAME else folder / recipe
