"""Names of learned rules and of what they are composed of; nothing large is imported."""

from __future__ import annotations

from metapp import door


def rule_names() -> list[str]:
    """All rules that have a name."""
    return [offer.name for offer in door.offers(door.Rule) if not offer.short]


def composition_names() -> list[str]:
    """The names that compositions are made of: short ones, and parts."""
    return [*(offer.name for offer in door.offers(door.Rule) if offer.short), *part_names()]


def part_names() -> list[str]:
    """All parts, in the order in which they act on a step."""
    return [offer.name for offer in door.offers(door.Part)]
