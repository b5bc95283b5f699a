"""A learned rule: parts, one after the other, as one update rule; the parts and the rules by name.

Free compositions have names, too: "adam+curvature+average".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from metapp.learning.adjoint import Loss, UpdateRule
from metapp.learning.app import App
from metapp.learning.names import composition_names, part_names, rule_names
from metapp.learning.recipe import Adam
from metapp.learning.rules.part import Before, Part
from metapp.learning.task import Params
from metapp.registry import Entry, registry


@dataclass(frozen=True)
class LearnedRule:
    """An update rule whose hyperparameters Meta learns.

    Attributes:
        name: of the rule or composition.
        parts: in the order in which they act.
    """

    name: str
    parts: tuple[Part, ...]

    def has(self, part: str) -> bool:
        """True if it has a part of this name."""
        return any(each.name == part for each in self.parts)

    def require(self, app: App, theta: Params) -> None:
        """Refuse an application that a part does not apply to.

        Args:
            app: the application.
            theta: parameters of one task.

        Raises:
            ValueError: names the part and the reason.
        """
        for part in self.parts:
            if reason := part.refusal(app, theta):
                raise ValueError(
                    f"rule '{self.name}': its part {part.name} does not apply to {app.name}: {reason}; choose a rule "
                    "without it."
                )

    def alpha(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """Learned hyperparameters [K, ...] before training.

        They make the rule the plain Adam `first` (but for its eps where the rule has none of its own), or SGD of its
        rate; tail averaging acts on the last step.

        Args:
            app: the application.
            theta: parameters of one task.
            steps: of a fit.
            first: settings of an Adam.

        Raises:
            ValueError: a part does not apply to the application.
        """
        self.require(app, theta)
        other = next(iter(theta.values()))
        parts = (part.initial(app, theta, steps, first) for part in self.parts)
        return {key: value.to(other) for initial in parts for key, value in initial.items()}

    def rule(self, alpha: Params) -> UpdateRule:
        """The update rule of learned hyperparameters [K, ...], or [K, T, ...] where each task has its own."""

        def init(theta: Params) -> Params:
            return {key: value for part in self.parts for key, value in part.state(alpha, theta).items()}

        return UpdateRule(alpha, init, self)

    def loss(self, app: App, loss: Loss) -> Loss:
        """The loss that its steps descend, of the application's own."""
        for part in self.parts:
            loss = part.loss(app, loss)
        return loss

    def __call__(self, alpha: Params, theta: Params, grads: Params, state: Params) -> tuple[Params, Params]:
        """One step, as `UpdateRule.step`."""
        directions = grads
        after: Params = {}
        for part in self.parts:
            directions = part.gradients(alpha, directions)
        for part in self.parts:
            directions, kept = part.directions(alpha, directions, state)
            after |= kept
        updates = directions
        for part in self.parts:
            updates = part.updates(alpha, updates)
        moved = {key: value - updates[key] if key in updates else value for key, value in theta.items()}
        for part in self.parts:
            moved, kept = part.moved(alpha, moved, Before(theta, grads, directions), state)
            after |= kept
        return moved, after

    def for_steps(self, alpha: Params, steps: int) -> Params:
        """Alpha for a fit of so many steps, whatever it was prepared for."""
        for part in self.parts:
            alpha = part.for_steps(alpha, steps)
        return alpha

    @property
    def settled(self) -> tuple[str, ...]:
        """The prefixes of hyperparameters that are taken from gradients of training tasks."""
        return tuple(prefix for part in self.parts for prefix in part.settled)

    def gather(self, alpha: Params, grads: Params) -> Params:
        """Statistics of the gradients [T, ...] of a step on training tasks, which are summed over steps."""
        return {key: value for part in self.parts for key, value in part.gather(alpha, grads).items()}

    def settle(self, alpha: Params, sums: Params) -> Params:
        """Alpha with what these sums say."""
        for part in self.parts:
            alpha = part.settle(alpha, sums)
        return alpha


def parts_by_name() -> Mapping[str, Part]:
    """All parts, in the order in which they act on a step."""
    return {name: _part(entry) for name, entry in registry().parts.items()}


@cache  # one object a part: compiled steps are found by it
def _part(entry: Entry) -> Part:
    part: Part = entry.load()()
    return part


def rule_of(name: str) -> LearnedRule:
    """The learned rule of a name, or of names of rules and parts with "+" between them, in any order.

    The same parts are the same rule: "curvature+loss+adam" is meta-curvature.

    Raises:
        ValueError: a name is unknown, or the parts do not go together.
    """
    return _composed(frozenset(_expanded(name, name)))


def _expanded(name: str, whole: str) -> set[str]:
    """The names of the parts of a rule that is a component of the rule `whole`."""
    if name in part_names():
        return {name}
    inner = (registry().compositions | registry().rules).get(name) if "+" not in name else name
    if inner is None:
        expected = ", ".join((*rule_names(), *composition_names()))
        raise ValueError(f"rule '{whole}': '{name}' is unknown, expected names of these, joined by +: {expected}.")
    return {part for each in inner.split("+") for part in _expanded(each, whole)}


@cache  # one object a rule: compiled steps are found by it
def _composed(names: frozenset[str]) -> LearnedRule:
    parts = tuple(_part(entry) for name, entry in registry().parts.items() if name in names)
    rule = LearnedRule(_name(names), parts)
    rates = [part.name for part in parts if part.is_rate]
    if len(rates) != 1:
        kinds = [name for name, part in parts_by_name().items() if part.is_rate]
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
    for rule, parts in registry().rules.items():
        if _expanded(parts, rule) == names:
            return rule
    short = {name: parts for name, parts in registry().compositions.items() if names.issuperset(parts.split("+"))}
    covered = {part for parts in short.values() for part in parts.split("+")}
    return "+".join([*short, *(part for part in part_names() if part in names - covered)])
