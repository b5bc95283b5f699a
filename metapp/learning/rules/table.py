"""The parts by name, the named rules, and free compositions of both: "adam+curvature+average"."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from metapp.learning.rules.average import Average
from metapp.learning.rules.basis import Basis
from metapp.learning.rules.betas import Betas
from metapp.learning.rules.curvature import Curvature
from metapp.learning.rules.eps import Eps
from metapp.learning.rules.loss import LossParameters
from metapp.learning.rules.network import Network
from metapp.learning.rules.part import Part
from metapp.learning.rules.rates import Paces, Rates, SharedRates, SignedRates
from metapp.learning.rules.rule import LearnedRule
from metapp.learning.rules.solve import Solve

# In the order in which they act on a step.
PARTS: Mapping[str, Part] = {
    part.name: part
    for part in (
        SignedRates(),
        Rates(),
        SharedRates(),
        Solve(),
        Betas(),
        LossParameters(),
        Paces(),
        Eps(),
        Curvature(),
        Network(),
        Average(),
        Basis(),
    )
}

# Short names, for compositions.
SHORT: Mapping[str, str] = {"adam": "rates+betas", "tied": "shared+pace"}

NAMED: Mapping[str, str] = {
    # the paper's rule: one rate per weight, the same at every step, any sign
    "meta-sgd": "sgd",
    # Adam with rates per weight and step, betas per step, and loss parameters
    "meta-adam": "adam+loss",
    # the same with one rate per weight for all steps, times one per parameter tensor and step: as small as meta-sgd's
    "meta-adam-tied": "tied+betas+loss",
    # the same with a learned eps, for recipes that start from General's encoder and train it through the steps
    "meta-encoder": "meta-adam-tied+eps",
    # the same with tail averaging, where samples are random, which lets the parameters scatter
    "meta-mean": "meta-encoder+average",
    # meta-encoder, and a convolutional network that adds to the steps of parameters on a grid
    "meta-lgd": "meta-encoder+network",
    # meta-mean, in the eigenbasis of the training tasks' gradients
    "meta-basis": "meta-mean+basis",
    # the same without the mean, for descents from coarse to fine, whose last iterates are of several sizes
    "meta-axes": "meta-encoder+basis",
    # meta-adam, its step multiplied by learned matrices from both sides
    "meta-curvature": "meta-adam+curvature",
    # ridge regression in the last layer, on learned features
    "ridge": "solve+loss",
}


def rule_of(name: str) -> LearnedRule:
    """The learned rule of a name, or of names of rules and parts with "+" between them, in any order.

    The same parts are the same rule: "curvature+loss+adam" is meta-curvature.

    Raises:
        ValueError: a name is unknown, or the parts do not go together.
    """
    return _composed(frozenset(_expanded(name, name)))


def _expanded(name: str, whole: str) -> set[str]:
    """The names of the parts of a rule that is a component of the rule `whole`."""
    if name in PARTS:
        return {name}
    inner = ({**SHORT, **NAMED}).get(name) if "+" not in name else name
    if inner is None:
        known = ", ".join((*NAMED, *SHORT, *PARTS))
        raise ValueError(f"rule '{whole}': '{name}' is unknown, expected names of these, joined by +: {known}.")
    return {part for each in inner.split("+") for part in _expanded(each, whole)}


@cache  # one object a rule: compiled steps are found by it
def _composed(names: frozenset[str]) -> LearnedRule:
    parts = tuple(part for name, part in PARTS.items() if name in names)
    rule = LearnedRule(_name(names), parts)
    kinds = [name for name, part in PARTS.items() if part.is_rate]
    rates = [name for name in kinds if rule.has(name)]
    if len(rates) != 1:
        raise ValueError(
            f"rule '{rule.name}': {' and '.join(rates) or 'no part'} for rates, expected one of {', '.join(kinds)} "
            "(adam has rates, tied has shared)."
        )
    for part in parts:
        if part.beside and not any(map(rule.has, part.beside)):
            raise ValueError(
                f"rule '{rule.name}': {part.name} says nothing by itself, expected {' or '.join(part.beside)} beside "
                "it; add that."
            )
    return rule


def _name(names: frozenset[str]) -> str:
    """The one name of a set of parts: a rule's if it has one, else the parts in order, with short names in front."""
    for rule, parts in NAMED.items():
        if _expanded(parts, rule) == names:
            return rule
    short = [each for each, parts in SHORT.items() if names.issuperset(parts.split("+"))]
    covered = {part for each in short for part in SHORT[each].split("+")}
    return "+".join([*short, *(part for part in PARTS if part in names - covered)])


RULES: Mapping[str, LearnedRule] = {name: rule_of(name) for name in NAMED}
