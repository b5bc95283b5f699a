"""Learned rules by name: those that ship, those of extensions, and compositions of both; nothing large is imported."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from metapp.registry import Entry, Registry, registry

if TYPE_CHECKING:
    from metapp.learning.rules import LearnedRule, Part

_PARTS = "metapp.learning.rules.parts"


def register(registry: Registry) -> None:
    """Add the rules and the parts that ship."""
    # parts, in the order in which they act on a step
    registry.parts["sgd"] = Entry(f"{_PARTS}:SignedRates")
    registry.parts["rates"] = Entry(f"{_PARTS}:Rates")
    registry.parts["shared"] = Entry(f"{_PARTS}:SharedRates")
    registry.parts["solve"] = Entry("metapp.learning.rules.solve:Solve")
    registry.parts["betas"] = Entry(f"{_PARTS}:Betas")
    registry.parts["loss"] = Entry(f"{_PARTS}:LossParameters")
    registry.parts["pace"] = Entry(f"{_PARTS}:Paces")
    registry.parts["eps"] = Entry(f"{_PARTS}:Eps")
    registry.parts["curvature"] = Entry(f"{_PARTS}:Curvature")
    registry.parts["network"] = Entry("metapp.learning.rules.network:Network")
    registry.parts["average"] = Entry(f"{_PARTS}:Average")
    registry.parts["basis"] = Entry(f"{_PARTS}:Basis")
    # short names within compositions
    registry.compositions["adam"] = "rates+betas"
    registry.compositions["tied"] = "shared+pace"
    # the paper's rule: one rate per weight, the same at every step, any sign
    registry.rules["meta-sgd"] = "sgd"
    # Adam with rates and betas per step, loss parameters, and steps multiplied by learned matrices from both sides
    registry.rules["meta-curvature"] = "adam+loss+curvature"
    # Adam with one rate per weight for all steps, times one per parameter tensor and step, and a learned eps, for
    # recipes that start from General's encoder and train it through the steps
    registry.rules["meta-encoder"] = "tied+betas+loss+eps"
    # the same, and a convolutional network that adds to the steps of parameters on a grid
    registry.rules["meta-lgd"] = "meta-encoder+network"
    # meta-encoder in the eigenbasis of the training tasks' gradients
    registry.rules["meta-axes"] = "meta-encoder+basis"
    # the same with tail averaging, where samples are random, which lets the parameters scatter
    registry.rules["meta-basis"] = "meta-axes+average"
    # ridge regression in the last layer, on learned features
    registry.rules["ridge"] = "solve+loss"


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
