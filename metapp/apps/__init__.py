"""Applications and their recipes, loaded by name; `metapp.registry` says which there are.

Each application that ships is a package here, with modules for its class, its recipes, its options and its
presenter. `exemplar` is the base of two of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from metapp.names import application_of, protocol_or_default, protocols_of, recipe_entries
from metapp.registry import load_reference

if TYPE_CHECKING:
    from metapp.appearance.presenter import Presenter
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
    return replace(app, protocol=protocol_or_default(name, protocol))


def presenter_of(app: App, values: Mapping[str, object] = MappingProxyType({})) -> Presenter[Any]:
    """Return the presenter that the registry names for an application.

    Args:
        app: the application, at the recipe of the fits that are shown.
        values: fields of presenters by name, such as `size`; those that the presenter does not have are left out.

    Raises:
        ValueError: files of the application cannot have the size.
    """
    kind: type[Presenter[Any]] = load_reference(application_of(app.name).presenter)
    known = {field.name for field in fields(kind)}
    return kind(app, **{name: value for name, value in values.items() if name in known})  # type: ignore[arg-type]


def is_first_protocol(app: App) -> bool:
    """True if an application is under its first protocol, or has no other."""
    return app.protocol in ("", *protocols_of(app.name)[:1])


def full_name(app: App) -> str:
    """Return the name of an application with its protocol, if it has any: illumination photo."""
    return f"{app.name} {app.protocol}".rstrip()


def protocol_entry(app: App) -> dict[str, str]:
    """Return the protocol as records, rows and headers of checkpoints state it; {} if an application has none."""
    return {"observe": app.protocol} if app.protocol else {}
