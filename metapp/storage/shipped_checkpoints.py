"""The places of the checkpoints that ship with the package.

Applications and runs ask for them by name; which recipe a fit takes is decided in `metapp.runs.resolve`.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path

QUICK_RECIPE_NAME, FULL_RECIPE_NAME = "quick", "full"
CHECKPOINT_PACKAGE = "metapp.checkpoints"  # the package that has the files, one folder an application


def shipped_checkpoint_path(app: str, name: str, recipe: str = QUICK_RECIPE_NAME) -> Path:
    """Return the path of a checkpoint that ships.

    A checkpoint of one recipe alone lies in a folder of the recipe's name. If there is none, the recipe takes the
    checkpoint of "full", else of "quick".

    Args:
        app: the name of the application.
        name: the file's name without suffix, such as "general-photo".
        recipe: the recipe by which the checkpoint is fitted.

    Returns:
        The file; if there is none, the place where it would lie for "quick".

    >>> shipped_checkpoint_path("brdf", "general").name
    'general.safetensors'
    """
    folders = []
    if recipe != QUICK_RECIPE_NAME:
        folders = [checkpoint_folder(app, recipe), checkpoint_folder(app, FULL_RECIPE_NAME)]
    files = [folder / f"{name}.safetensors" for folder in (*folders, checkpoint_folder(app))]
    return next((path for path in files if path.is_file()), files[-1])


def shipped_checkpoint_names(app: str) -> dict[str, list[str]]:
    """List the names of checkpoints that ship for an application.

    Returns:
        The names by the application's name, and those that a recipe alone has by "<app> <recipe>".
    """
    names_by_key: dict[str, list[str]] = {app: []}
    for path in sorted(checkpoint_folder(app).rglob("*.safetensors")):
        key = " ".join([app, *path.parent.relative_to(checkpoint_folder(app)).parts])
        names_by_key.setdefault(key, []).append(path.stem)
    return names_by_key


def checkpoint_folder(app: str, recipe: str = QUICK_RECIPE_NAME) -> Path:
    """Return the folder of an application's checkpoints.

    Args:
        app: the name of the application.
        recipe: "quick" for the checkpoints of all recipes, another recipe for those that it alone has.
    """
    folder = Path(str(resources.files(CHECKPOINT_PACKAGE))) / app
    return folder if recipe == QUICK_RECIPE_NAME else folder / recipe
