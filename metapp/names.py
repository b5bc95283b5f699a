"""Names that options, help and errors list: applications, protocols, recipes, rules, inputs and exports.

Every list comes from the registry, so that an extension's names are listed like the core's. Nothing is loaded to list
its name.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from metapp.registry import Application, Export, Format, RecipeEntry, registry


def did_you_mean(word: str, names: Iterable[str]) -> str:
    """Return a question that ends an error about an unknown word, if names begin with it or resemble it; else "".

    >>> did_you_mean("mreta", ["general", "meta"])
    " Did you mean 'meta'?"
    """
    choices = list(names)
    similar = [name for name in choices if word and name.startswith(word)] or difflib.get_close_matches(
        word, choices, 1
    )
    return f" Did you mean {' or '.join(map(repr, similar))}?" if similar else ""


def app_names() -> list[str]:
    """Return the names of all applications, sorted.

    >>> app_names()[:2]
    ['brdf', 'illumination']
    """
    return sorted(registry().applications)


def application_of(name: str) -> Application:
    """Return the entry of an application.

    Raises:
        ValueError: there is no application of that name; the message lists all names.

    >>> application_of("illumination").protocols
    {'reference': 'map', 'photo': 'photos'}
    """
    applications = registry().applications
    if name not in applications:
        expected = f"expected one of {', '.join(sorted(applications))}.{did_you_mean(name, applications)}"
        raise ValueError(f"application '{name}': not known, {expected}")
    return applications[name]


def protocols_of(app: str) -> tuple[str, ...]:
    """Return the protocols of an application (the values of --observe), the default first; () if there is only one."""
    return tuple(application_of(app).protocols)


def protocol_or_default(app: str, protocol: str = "") -> str:
    """Return the given protocol, or the application's default one if it is ""; "" if there is only one.

    >>> protocol_or_default("illumination")
    'reference'
    """
    return protocol or next(iter(application_of(app).protocols), "")


def recipe_names(app: str) -> list[str]:
    """Return the names of an application's recipes under all its protocols.

    >>> recipe_names("illumination")
    ['quick', 'full', 'paper', 'paper-long']
    """
    return list(dict.fromkeys(name for recipe_app, _, name in registry().recipes if recipe_app == app))


def recipe_entries(app: str, protocol: str = "") -> dict[str, RecipeEntry]:
    """Return the recipes of an application under a protocol, by name; "" stands for the default protocol."""
    return registry().recipes.of(app, protocol_or_default(app, protocol))


def embedded_apps() -> list[str]:
    """Return the names of the applications that have an embedded data set, sorted.

    >>> embedded_apps()[:2]
    ['brdf', 'illumination']
    """
    return sorted(registry().synthetic)


def rule_words() -> list[str]:
    """Return the words that --rule accepts, joined by +: rules, compositions and parts.

    >>> rule_words()[:2]
    ['meta-sgd', 'meta-curvature']
    """
    tables = registry()
    return [*tables.rules, *tables.compositions, *tables.parts]


def input_formats(app: str) -> dict[str, Format]:
    """Return the formats that fits of an application accept as INPUT, by name, sorted.

    >>> list(input_formats("texture"))
    ['images']
    """
    return {name: entry for name, entry in sorted(registry().formats.items()) if entry.app == app and entry.inputs}


def exports_of(app: str) -> dict[str, Export]:
    """Return the forms that fits of an application can be written in, by name, sorted.

    >>> list(exports_of("texture"))
    ['asset', 'exr', 'png16']
    """
    return dict(sorted(registry().exports.of(app).items()))
