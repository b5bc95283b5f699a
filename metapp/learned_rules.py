"""Learned rules by name: those of the registry and compositions of them."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from metapp.learning.rules import LearnedRule, Part, compose
from metapp.registry import registry


@cache
def rule_of(name: str) -> LearnedRule:
    """The learned rule of a name, or of a composition of names with "+" between them.

    Raises:
        ValueError: a name is unknown, or the parts do not go together.

    >>> rule_of("curvature+loss+adam").name
    'meta-curvature'
    """
    tables = registry()
    return compose(
        name, list(tables.parts), lambda part: _part(tables.parts[part].load()), tables.rules, tables.compositions
    )


@cache  # compiled steps are found by the part
def _part(kind: Callable[[], Part]) -> Part:
    return kind()
