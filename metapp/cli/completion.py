"""Words that shells complete: applications and what extensions offer for them; nothing large is imported."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable

from metapp.registry import app_names, exports_of, protocols_of, recipe_names, registry, rule_words

LINE = ("COMP_WORDS", "_TYPER_COMPLETE_ARGS")  # where shells leave the line that is completed
Words = Callable[[str], list[str]]


def _words(names: Callable[[], Iterable[str]], between: str = "") -> Words:
    """The function that typer asks for names that begin as a word does; `between` may stand between several."""

    def complete(incomplete: str) -> list[str]:
        before, mark, last = incomplete.rpartition(between) if between else ("", "", incomplete)
        return [before + mark + name for name in dict.fromkeys(names()) if name.startswith(last)]

    return complete


def _of_apps(names: Callable[[str], Iterable[str]]) -> Callable[[], Iterable[str]]:
    """Names that belong to the applications which the line has so far, also as a part of a run's path; else to all."""

    def of_line() -> Iterable[str]:
        # by the whole line: typer parses none whose last option has no value yet
        line, apps = " ".join(os.environ.get(name, "") for name in LINE), app_names()
        named = [app for app in apps if re.search(rf"(?<![\w-]){app}(?![\w-])", line)]
        return (name for app in named or apps for name in names(app))

    return of_line


applications = _words(app_names)
recipes = _words(_of_apps(recipe_names))
rules = _words(rule_words, "+")
observations = _words(_of_apps(protocols_of))
exports = _words(_of_apps(exports_of), ",")
kinds = _words(lambda: (*_of_apps(exports_of)(), *registry().file_exports))
methods = _words(_of_apps(lambda app: registry().baselines.of(app)))
tables = _words(lambda: (*registry().tables, "all"))
devices = _words(lambda: ("auto", "cpu", "cuda"))
