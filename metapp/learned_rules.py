"""Learned rules by name, as --rule names them."""

from __future__ import annotations

from metapp.entries import did_you_mean
from metapp.learning.rules import LearnedRule
from metapp.registry import registry


def rule_of(name: str) -> LearnedRule:
    """Return the learned rule of a name.

    Raises:
        ValueError: there is no rule of that name; the message lists all names.

    >>> [part.name for part in rule_of("meta-sgd").parts]
    ['rates']
    """
    rules = registry().rules
    if name not in rules:
        raise ValueError(
            f"'{name}' is not a rule; expected one of {', '.join(rules)}.{did_you_mean(name, list(rules))}"
        )
    return rules[name].load()
