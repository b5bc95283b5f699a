"""Names that options, help and errors list: applications, protocols, recipes, rules, inputs and exports."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from metapp.registry import Application, Export, Format, RecipeEntry, registry


def did_you_mean(word: str, names: Iterable[str]) -> str:
    """A question after an error about a word that is no name, if some names begin so or one is like it; else "".

    >>> did_you_mean("mreta", ["general", "meta"])
    " Did you mean 'meta'?"
    """
    choices = list(names)
    near = [name for name in choices if word and name.startswith(word)] or difflib.get_close_matches(word, choices, 1)
    return f" Did you mean {' or '.join(map(repr, near))}?" if near else ""


def app_names() -> list[str]:
    """The names of all applications.

    >>> app_names()[:2]
    ['brdf', 'illumination']
    """
    return sorted(registry().applications)


def application_of(name: str) -> Application:
    """The entry of an application.

    Raises:
        ValueError: there is none of that name; the message lists those that exist.

    >>> application_of("illumination").protocols
    {'reference': 'map', 'photo': 'photos'}
    """
    applications = registry().applications
    if name not in applications:
        expected = f"expected one of {', '.join(sorted(applications))}.{did_you_mean(name, applications)}"
        raise ValueError(f"application '{name}': not known, {expected}")
    return applications[name]


def protocols_of(app: str) -> tuple[str, ...]:
    """The protocols of an application, the values of --observe, the default first; () if there is no choice."""
    return tuple(application_of(app).protocols)


def protocol_or_default(app: str, protocol: str = "") -> str:
    """The protocol, the default one if none is named; "" if there is no choice.

    >>> protocol_of("illumination")
    'reference'
    """
    return protocol or next(iter(application_of(app).protocols), "")


def recipe_names(app: str) -> list[str]:
    """The recipes of an application under all its protocols.

    >>> recipe_names("illumination")
    ['quick', 'full', 'paper', 'paper-long']
    """
    return list(dict.fromkeys(name for other, _, name in registry().recipes if other == app))


def recipe_entries(app: str, protocol: str = "") -> dict[str, RecipeEntry]:
    """The recipes of an application under a protocol, its default one if none is named."""
    return registry().recipes.of(app, protocol_or_default(app, protocol))


def embedded_apps() -> list[str]:
    """Return the names of the applications that have an embedded data set, sorted.

    >>> embedded_apps()[:2]
    ['brdf', 'illumination']
    """
    return sorted(registry().synthetic)


def rule_words() -> list[str]:
    """The words of --rule, which + joins: rules, short names of compositions, and parts.

    >>> rule_words()[:2]
    ['meta-sgd', 'meta-curvature']
    """
    tables = registry()
    return [*tables.rules, *tables.compositions, *tables.parts]


def input_formats(app: str) -> dict[str, Format]:
    """The formats that fits of an application take as INPUT, sorted by name.

    >>> list(inputs_of("texture"))
    ['images']
    """
    return {name: form for name, form in sorted(registry().formats.items()) if form.app == app and form.inputs}


def exports_of(app: str) -> dict[str, Export]:
    """The forms that fits of an application can be written in, sorted by name.

    >>> list(exports_of("texture"))
    ['asset', 'exr', 'png16']
    """
    return dict(sorted(registry().exports.of(app).items()))
