"""Learned rules by name: those of the registry and compositions of them; nothing large is imported."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from metapp.registry import Entry, registry

if TYPE_CHECKING:
    from metapp.learning.rules import LearnedRule, Part


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
