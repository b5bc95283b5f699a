"""Words that shells complete: applications and what extensions offer for them; nothing large is imported."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable

from data_tools.formats import exports_of
from metapp.apps import app_names, protocols_of, recipe_names
from metapp.evaluation.tables import ALL, table_names
from metapp.registry import registry
from metapp.rules import composition_names, rule_names

DEVICES = ("auto", "cpu", "cuda")

LINE = ("COMP_WORDS", "_TYPER_COMPLETE_ARGS")  # where shells leave the line that is completed


def applications(incomplete: str) -> list[str]:
    """Names of applications."""
    return _that_begin(incomplete, app_names())


def recipes(incomplete: str) -> list[str]:
    """Recipes of the applications that are named, of all where none is."""
    return _that_begin(incomplete, (name for app in _named() for name in recipe_names(app)))


def rules(incomplete: str) -> list[str]:
    """Rules and parts of rules, after a + too."""
    return _after("+", incomplete, (*rule_names(), *composition_names()))


def observations(incomplete: str) -> list[str]:
    """Protocols, the values of --observe."""
    return _that_begin(incomplete, (name for app in _named() for name in protocols_of(app)))


def exports(incomplete: str) -> list[str]:
    """Kinds of files that fits are written in, after a comma too."""
    return _after(",", incomplete, (name for app in _named() for name in exports_of(app)))


def kinds(incomplete: str) -> list[str]:
    """Kinds of files that `metapp export` writes."""
    return _that_begin(incomplete, (*exports(incomplete), *registry().file_exports))


def methods(incomplete: str) -> list[str]:
    """Baselines."""
    return _that_begin(incomplete, (name for app in _named() for name in registry().baselines.of(app)))


def tables(incomplete: str) -> list[str]:
    """Tables of `metapp evaluate`."""
    return _that_begin(incomplete, (*table_names(), ALL))


def devices(incomplete: str) -> list[str]:
    """Devices."""
    return _that_begin(incomplete, DEVICES)


def _named() -> list[str]:
    """The applications that are named before the word that is completed, also as a part of a run's path; else all."""
    # by the whole line: typer parses none whose last option has no value yet
    line = " ".join(os.environ.get(name, "") for name in LINE)
    return [name for name in app_names() if re.search(rf"(?<![\w-]){name}(?![\w-])", line)] or app_names()


def _that_begin(incomplete: str, names: Iterable[str]) -> list[str]:
    return [name for name in dict.fromkeys(names) if name.startswith(incomplete)]


def _after(mark: str, incomplete: str, names: Iterable[str]) -> list[str]:
    """Words of which several may stand with a mark between them."""
    before, mark_before, last = incomplete.rpartition(mark)
    return [before + mark_before + name for name in _that_begin(last, names)]
