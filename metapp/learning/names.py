"""Names of learned rules and of what they are composed of; nothing large is imported."""

from __future__ import annotations

from metapp.registry import registry


def rule_names() -> list[str]:
    """All rules that have a name."""
    return list(registry().rules)


def composition_names() -> list[str]:
    """The names that compositions are made of: short ones, and parts."""
    return [*registry().compositions, *part_names()]


def part_names() -> list[str]:
    """All parts, in the order in which they act on a step."""
    return list(registry().parts)
