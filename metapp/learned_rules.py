"""Learned rules by name: rules, parts and compositions of the registry, as --rule names them.

`metapp.learning.rules` composes parts and knows no registry; this module passes it the parts and the names that are
registered.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from metapp.learning.rules import LearnedRule, Part, compose
from metapp.registry import registry


@cache
def rule_of(name: str) -> LearnedRule:
    """Return the learned rule of a name, or of a composition of names with "+" between them.

    Raises:
        ValueError: a name is unknown, or the parts do not go together.

    >>> rule_of("curvature+loss+adam").name
    'meta-curvature'
    """
    tables = registry()
    return compose(
        name, list(tables.parts), lambda part: _make_part(tables.parts[part].load()), tables.rules, tables.compositions
    )


@cache
def _make_part(factory: Callable[[], Part]) -> Part:
    """Make the part of an entry, once for all rules, as the cache of compiled steps compares parts by identity."""
    return factory()
