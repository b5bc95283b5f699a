"""Applications and their recipes, loaded by name; `metapp.registry` says which there are.

Each application that ships is a package here, with modules for its class, its recipes and its options.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from metapp.registry import application_of, protocol_of, protocols_of, recipe_entries

if TYPE_CHECKING:
    from metapp.learning.app import App
    from metapp.learning.recipe import Recipe


def class_of(name: str) -> type[App]:
    """The class of the application of that name; ValueError if there is none."""
    result: type[App] = application_of(name).load()
    return result


def recipe_of(app: str, name: str, protocol: str = "") -> Recipe:
    """The recipe of that name of an application under a protocol, its default one if none is named."""
    result: Recipe = recipe_entries(app, protocol)[name].load()
    return result


def recipes_of(app: str, protocol: str = "") -> Mapping[str, Recipe]:
    """The recipes of an application under a protocol, its default one if none is named.

    They are "quick", "full", of the size that people use, and "paper"; some applications have more.
    """
    return {name: entry.load() for name, entry in recipe_entries(app, protocol).items()}


def app_of(name: str, recipe: Recipe, protocol: str = "", *, rule: str = "") -> App:
    """An application with the network of a recipe.

    Args:
        name: the application's.
        recipe: as of `recipe_of`, or made of one.
        protocol: a value of --observe; "" for the default one.
        rule: a learned rule, which may have a network of its own.
    """
    app = (recipe.training(rule).app if rule else None) or recipe.app
    return replace(app, protocol=protocol_of(name, protocol))


def is_first_protocol(app: App) -> bool:
    """True if an application is under its first protocol, or has no other."""
    return app.protocol in ("", *protocols_of(app.name)[:1])
