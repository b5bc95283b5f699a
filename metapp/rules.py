"""Learned rules by name: those that ship, those of extensions, and compositions of both; nothing large is imported."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from metapp.registry import Entry, registry

if TYPE_CHECKING:
    from metapp.learning.rules import LearnedRule, Part


def rule_names() -> list[str]:
    """The names of rules.

    >>> rule_names()[:2]
    ['meta-sgd', 'meta-curvature']
    """
    return list(registry().rules)


def composition_names() -> list[str]:
    """The further names within compositions: short ones, then parts.

    >>> composition_names()[:3]
    ['adam', 'tied', 'sgd']
    """
    return [*registry().compositions, *registry().parts]


def rule_of(name: str) -> LearnedRule:
    """The learned rule of a name, or of a composition of names with "+" between them.

    Raises:
        ValueError: a name is unknown, or the parts do not go together.

    >>> rule_of("curvature+loss+adam").name
    'meta-curvature'
    """
    from metapp.learning.rules import compose

    tables = registry()
    parts = {part: _part(entry) for part, entry in tables.parts.items()}
    return compose(name, parts, tables.rules, tables.compositions)


@cache  # compiled steps are found by the part
def _part(entry: Entry) -> Part:
    part: Part = entry.load()()
    return part
