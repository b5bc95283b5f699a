"""The applications: one is a package here with three modules.

The package itself defines APP, the class of the application; `recipes` defines RECIPES, its recipes by name for each
protocol ("" where there is but one), the default protocol first; `presentation` defines PRESENTATION.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from metapp.storage.text import meant

if TYPE_CHECKING:
    from metapp.appearance.presentation import Presentation
    from metapp.learning.app import App
    from metapp.learning.recipe import Recipe


def app_names() -> list[str]:
    """All applications, found by listing this folder; nothing is imported."""
    return sorted(module.name for module in pkgutil.iter_modules(__path__))


def class_of(name: str) -> type[App]:
    """The class of the application of that name.

    Raises:
        ValueError: there is none; the message lists those that exist.
    """
    result: type[App] = _module(name, ".app").APP
    return result


def protocols_of(name: str) -> tuple[str, ...]:
    """What fits of an application may see, the values of --observe, the default first; () where there is no choice."""
    return tuple(filter(None, _recipes(name)))


def recipes_of(name: str, protocol: str = "") -> Mapping[str, Recipe]:
    """The recipes of an application under a protocol, its default one where none is named.

    They are "paper", "quick", and "full", of the size that people use; some applications have more.
    """
    recipes = _recipes(name)
    return recipes[protocol or next(iter(recipes))]


def app_of(name: str, recipe: Recipe, protocol: str = "", *, rule: str = "") -> App:
    """An application with the network of a recipe.

    Args:
        name: the application's.
        recipe: of the table `recipes_of`, or made of one.
        protocol: what fits may see; "" for the default one.
        rule: a learned rule, which may have a network of its own.
    """
    setup = recipe.training(rule).setup if rule else None
    return class_of(name)(recipe.setup if setup is None else setup, protocol or next(iter(_recipes(name))))


def presentation_of(app: App, size: tuple[int, int] | None = None) -> Presentation[Any]:
    """What screens and files need of an application, at its setup and under its protocol.

    Args:
        app: the application.
        size: of what fits make for their users, height and width in px; None for the application's own choice.
    """
    result: Presentation[Any] = _module(app.name, ".presentation").PRESENTATION(app, size)
    return result


def _recipes(name: str) -> Mapping[str, Mapping[str, Recipe]]:
    result: Mapping[str, Mapping[str, Recipe]] = _module(name, ".recipes").RECIPES
    return result


def _module(name: str, part: str = "") -> Any:
    if name not in app_names():
        known = app_names()
        raise ValueError(f"application '{name}': not known, expected one of {', '.join(known)}.{meant(name, known)}")
    return importlib.import_module(f"metapp.apps.{name}{part}")
