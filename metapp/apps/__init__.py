"""The applications by name: their classes and recipes.

What ships is a package here for each: it registers the application, and has modules for its class and its recipes.
Nothing here is imported before it is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from metapp.options import AppOptions
from metapp.registry import Application, did_you_mean, load, registry
from metapp.registry import Recipe as RecipeEntry

if TYPE_CHECKING:
    from metapp.learning.app import App
    from metapp.learning.recipe import Recipe


def app_names() -> list[str]:
    """All applications; nothing is imported but the modules that register them."""
    return sorted(registry().applications)


def application_of(name: str) -> Application:
    """The entry of an application.

    Raises:
        ValueError: there is none of that name; the message lists those that exist.
    """
    applications = registry().applications
    if name not in applications:
        expected = f"expected one of {', '.join(sorted(applications))}.{did_you_mean(name, applications)}"
        raise ValueError(f"application '{name}': not known, {expected}")
    return applications[name]


def class_of(name: str) -> type[App]:
    """The class of the application of that name; ValueError where there is none."""
    result: type[App] = application_of(name).load()
    return result


def protocols_of(name: str) -> tuple[str, ...]:
    """The protocols of an application, the values of --observe, the default first; () where there is no choice."""
    return application_of(name).protocols


def options_of(name: str) -> type[AppOptions]:
    """The dataclass of an application's own options."""
    result: type[AppOptions] = load(application_of(name).options)
    return result


def recipe_names(name: str) -> list[str]:
    """The recipes of an application under all its protocols."""
    return list(dict.fromkeys(recipe for app, _, recipe in registry().recipes if app == name))


def recipe_entries(name: str, protocol: str = "") -> dict[str, RecipeEntry]:
    """The entries of recipes of an application under a protocol, its default one where none is named."""
    return registry().recipes.of(name, protocol or next(iter(protocols_of(name)), ""))


def recipes_of(name: str, protocol: str = "") -> Mapping[str, Recipe]:
    """The recipes of an application under a protocol, its default one where none is named.

    They are "quick", "full", of the size that people use, and "paper"; some applications have more.
    """
    return {recipe: entry.load() for recipe, entry in recipe_entries(name, protocol).items()}


def app_of(name: str, recipe: Recipe, protocol: str = "", *, rule: str = "") -> App:
    """An application with the network of a recipe.

    Args:
        name: the application's.
        recipe: of the table `recipes_of`, or made of one.
        protocol: what fits may see; "" for the default one.
        rule: a learned rule, which may have a network of its own.
    """
    app = (recipe.training(rule).app if rule else None) or recipe.app
    return replace(app, protocol=protocol or next(iter(protocols_of(name)), ""))
