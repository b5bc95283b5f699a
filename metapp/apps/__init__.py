"""Applications, their recipes and their presenters, loaded by the names that the registry lists.

Each application that ships is a package here: `app` has its class, `recipes` its recipes, `presenter` what people look
at and `options`, if there is one, its own options. Begin with `brdf`; `exemplar` is the base of `texture` and
`svbrdf_stationary`; `svbrdf_nonstationary`, `illumination` and `transport` stand alone. This module knows none of them
by name: it loads what `metapp.registry` says there is.
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
    """Return the class of the application of a name.

    Raises:
        ValueError: there is no such application.
    """
    result: type[App] = application_of(name).load()
    return result


def recipe_of(app: str, name: str, protocol: str = "") -> Recipe:
    """Return the recipe of a name, such as "quick", of an application.

    Args:
        app: the application's name.
        name: the recipe's name.
        protocol: what a fit observes, a value of --observe; "" for the application's default.
    """
    result: Recipe = recipe_entries(app, protocol)[name].load()
    return result


def recipes_of(app: str, protocol: str = "") -> Mapping[str, Recipe]:
    """Return the recipes of an application by name, all under one protocol; "" stands for its default protocol.

    They are "quick", "full", of the size that people use, and "paper"; some applications have more.
    """
    return {name: entry.load() for name, entry in recipe_entries(app, protocol).items()}


def app_of(name: str, recipe: Recipe, protocol: str = "", *, rule: str = "") -> App:
    """Return an application with the network of a recipe.

    Args:
        name: the application's name.
        recipe: a recipe of the application, from :func:`recipe_of` or changed.
        protocol: what a fit observes, a value of --observe; "" for the application's default.
        rule: a learned rule, which may have a network of its own; "" for none.
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
    presenter_class: type[Presenter[Any]] = load_reference(application_of(app.name).presenter)
    known = {field.name for field in fields(presenter_class)}
    known_values = {name: value for name, value in values.items() if name in known}
    return presenter_class(app, **known_values)  # type: ignore[arg-type]


def is_first_protocol(app: App) -> bool:
    """Tell whether an application is under its first protocol, or has but one."""
    return app.protocol in ("", *protocols_of(app.name)[:1])


def full_name(app: App) -> str:
    """Return the name of an application followed by its protocol, if it has any, as in "illumination photo"."""
    return f"{app.name} {app.protocol}".rstrip()


def protocol_entry(app: App) -> dict[str, str]:
    """Return the protocol as records, rows and headers of checkpoints state it; {} if an application has none."""
    return {"observe": app.protocol} if app.protocol else {}
