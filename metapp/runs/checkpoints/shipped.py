"""The checkpoints that ship."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from metapp.apps import recipe_entries, recipes_of

QUICK, FULL = "quick", "full"
PACKAGE = "metapp.checkpoints"


def shipped_path(app: str, name: str, recipe: str = QUICK, protocol: str = "") -> Path:
    """Where a checkpoint that ships is, by its file name without suffix.

    A recipe has a folder, for what it does not share with "full" and "quick"; that of "full" has nothing for "quick".
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
    """True if checkpoints of a recipe ship: its own, or those of "quick" where it fits the same network."""
    same = recipe == FULL and full_fits_as_quick(app)
    return recipe == QUICK or same or _recipe_folder(app, recipe, protocol).is_dir()


def full_fits_as_quick(app: str) -> bool:
    """True if networks of "full" are of the size of those of "quick": then all that fits differ in is its rule."""
    recipes = recipes_of(app)
    return recipes[FULL].app == recipes[QUICK].app


def usual_recipe(app: str) -> str:
    """The recipe where none is named: "full", the best rule and size, where it ships, else "quick"."""
    return FULL if FULL in recipe_entries(app) and ships(app, FULL) else QUICK


def _recipe_folder(app: str, recipe: str, protocol: str) -> Path:
    """The folder of a recipe's own checkpoints: that of the extension which has it, else of what ships for all."""
    entry = recipe_entries(app, protocol).get(recipe)
    package = entry.checkpoints if entry else ""
    return Path(str(resources.files(package))) / recipe if package else _folder(app) / recipe


def _folder(app: str) -> Path:
    return Path(str(resources.files(PACKAGE))) / app
