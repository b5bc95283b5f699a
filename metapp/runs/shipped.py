"""Where the checkpoints are that ship with metapp, and for which recipes there are any."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from metapp.apps import recipes_of

QUICK, FULL = "quick", "full"


def shipped_path(app: str, name: str, recipe: str = QUICK) -> Path:
    """Where a checkpoint that ships is, by its file name without suffix.

    A recipe of another size has a folder, for what it does not share with "quick".
    """
    folder, file = _folder(app), f"{name}.safetensors"
    own = folder / recipe / file
    return own if own.is_file() else folder / file


def shipped_names(app: str) -> dict[str, list[str]]:
    """The checkpoints that ship for an application, by it, and for its recipe of another size, by "<app> full"."""
    folders = {app: _folder(app), f"{app} {FULL}": _folder(app) / FULL}
    names = {key: sorted(path.stem for path in folder.glob("*.safetensors")) for key, folder in folders.items()}
    return {key: found for key, found in names.items() if found or key == app}


def ships(app: str, recipe: str) -> bool:
    """Whether checkpoints of a recipe ship: its own, or those of "quick" where it fits the same network."""
    same = recipe == FULL and full_fits_as_quick(app)
    return recipe == QUICK or same or (_folder(app) / recipe).is_dir()


def full_fits_as_quick(app: str) -> bool:
    """Whether networks of "full" are of the size of those of "quick": then all that fits differ in is its rule."""
    recipes = recipes_of(app)
    result: bool = recipes[FULL].setup == recipes[QUICK].setup
    return result


def _folder(app: str) -> Path:
    return Path(str(resources.files("metapp.checkpoints"))) / app
