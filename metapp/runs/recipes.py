"""Checkpoints that ship for recipes, and the recipe that is usual."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from metapp.apps import recipe_of
from metapp.names import recipe_entries

QUICK, FULL = "quick", "full"
PACKAGE = "metapp.checkpoints"


def shipped_path(app: str, name: str, recipe: str = QUICK, protocol: str = "") -> Path:
    """The path of a checkpoint that ships, by its file name without suffix.

    Checkpoints that a recipe does not share with "full" and "quick" are in a folder of its own.
    """
    folders = [_recipe_folder(app, recipe, protocol), _folder(app) / FULL] if recipe != QUICK else []
    files = [folder / f"{name}.safetensors" for folder in (*folders, _folder(app))]
    return next((path for path in files if path.is_file()), files[-1])


def shipped_names(app: str) -> dict[str, list[str]]:
    """The checkpoints that ship for an application, by it, and for its recipe of another size, by "<app> full"."""
    folders = {app: _folder(app), f"{app} {FULL}": _folder(app) / FULL}
    names = {key: sorted(path.stem for path in folder.glob("*.safetensors")) for key, folder in folders.items()}
    return {key: found for key, found in names.items() if found or key == app}


def ships(app: str, recipe: str, protocol: str = "") -> bool:
    """True if checkpoints of a recipe ship: its own, or those of "quick" if it fits the same network."""
    own = recipe == QUICK or _recipe_folder(app, recipe, protocol).is_dir()
    return own or (recipe == FULL and recipe_of(app, FULL).app == recipe_of(app, QUICK).app)


def usual_recipe(app: str) -> str:
    """The recipe if none is named: "full", the best rule and size, if it ships, else "quick"."""
    return FULL if FULL in recipe_entries(app) and ships(app, FULL) else QUICK


def _recipe_folder(app: str, recipe: str, protocol: str) -> Path:
    """The folder of a recipe's own checkpoints: that of the extension which has it, else that of all."""
    entry = recipe_entries(app, protocol).get(recipe)
    package = entry.checkpoints if entry else ""
    return Path(str(resources.files(package))) / recipe if package else _folder(app) / recipe


def _folder(app: str) -> Path:
    return Path(str(resources.files(PACKAGE))) / app
