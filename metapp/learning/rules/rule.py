"""A learned rule: parts, one after the other, as one update rule; and compositions of parts by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from metapp.learning.adjoint import Loss, UpdateRule
from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.task import Params


class StepInput(NamedTuple):
    """The state of a step before it moves: trees of tensors [T, ...], but for `solve` of the names of theta.

    Attributes:
        theta: the parameters.
        grads: their gradients, as the loss gave them.
        directions: of all parts together, before any rate.
    """

    theta: Params
    grads: Params
    directions: Params


class Part:
    """A part of a learned rule; methods that it does not define change nothing.

    A step passes the gradients through `gradients` of all parts, then through their `directions`, then through their
    `updates`, which are subtracted, and the parameters that this gives through their `moved`. Wherever a step is
    concerned, `alpha` holds the hyperparameters of that step, with a task axis.

    Attributes:
        name: in compositions, such as "adam+curvature".
        is_rate: whether it says how far parameters move: of such parts a rule has one.
        needs_one_of: names of parts; a rule that has this part must have one of them, if there are any.
        settled: prefixes of hyperparameters that are estimated from gradients of training tasks, before the
            outer loop and before any search of an Adam.
    """

    name: str
    is_rate: bool = False
    needs_one_of: tuple[str, ...] = ()
    settled: tuple[str, ...] = ()

    def refusal(self, app: App, theta: Params) -> str:
        """The reason that it does not apply to an application with these parameters of one task; "" if it does."""
        return ""

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """Hyperparameters [K, ...] before training, those of the plain Adam `first` if it has them.

        Args:
            app: the application.
            theta: parameters of one task.
            steps: of a fit; K is this, or 1 for values that are the same at all steps.
            first: settings of an Adam.
        """
        return {}

    def loss(self, app: App, loss: Loss) -> Loss:
        """The loss that steps descend, of the application's own."""
        return loss

    def state(self, alpha: Params, theta: Params) -> Params:
        """The memory that it keeps from step to step, before the first one; `theta` has a task axis."""
        return {}

    def gradients(self, alpha: Params, grads: Params) -> Params:
        """Transform the gradients."""
        return grads

    def directions(self, alpha: Params, directions: Params, state: Params) -> tuple[Params, Params]:
        """Transform the directions, and return its memory with them."""
        return directions, {}

    def updates(self, alpha: Params, updates: Params) -> Params:
        """Transform the updates, the directions at first; they are subtracted from the parameters."""
        return updates

    def moved(self, alpha: Params, moved: Params, before: StepInput, state: Params) -> tuple[Params, Params]:
        """Transform the parameters after the step, and return its memory with them."""
        return moved, {}

    def for_steps(self, alpha: Params, steps: int) -> Params:
        """Alpha [K, ...] for a fit of so many steps, whatever it was prepared for."""
        return alpha

    def gather(self, alpha: Params, grads: Params) -> Params:
        """Statistics of the gradients [T, ...] of a step on training tasks, which are summed over steps."""
        return {}

    def settle(self, alpha: Params, sums: Params) -> Params:
        """Alpha [K, ...] with the values that follow from these sums."""
        return alpha


@dataclass(frozen=True)
class LearnedRule:
    """An update rule whose hyperparameters Meta learns.

    Attributes:
        name: of the rule or composition.
        parts: in the order in which they act.
    """

    name: str
    parts: tuple[Part, ...]

    def has_part(self, part: str) -> bool:
        """True if it has a part of this name."""
        return any(each.name == part for each in self.parts)

    def check_app(self, app: App, theta: Params) -> None:
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

    def initial_alpha(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """Learned hyperparameters [K, ...] before training.

        They make the rule the plain Adam `first` (but for its eps if the rule has none of its own), or SGD of its
        rate; tail averaging acts on the last step.

        Args:
            app: the application.
            theta: parameters of one task.
            steps: of a fit.
            first: settings of an Adam.

        Raises:
            ValueError: a part does not apply to the application.
        """
        self.check_app(app, theta)
        other = next(iter(theta.values()))
        parts = (part.initial(app, theta, steps, first) for part in self.parts)
        return {key: value.to(other) for initial in parts for key, value in initial.items()}

    def update_rule(self, alpha: Params) -> UpdateRule:
        """The update rule of learned hyperparameters [K, ...], or [K, T, ...] if each task has its own."""

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
            moved, kept = part.moved(alpha, moved, StepInput(theta, grads, directions), state)
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
        """Alpha with the values that follow from these sums."""
        for part in self.parts:
            alpha = part.settle(alpha, sums)
        return alpha


def compose(
    name: str,
    names: Sequence[str],
    part_of: Callable[[str], Part],
    rules: Mapping[str, str],
    compositions: Mapping[str, str],
) -> LearnedRule:
    """The learned rule of a composition: names of parts, rules and compositions with "+" between them, in any order.

    Equal sets of parts give equal rules.

    Args:
        name: of the composition.
        names: of all parts, in the order in which they act on a step.
        part_of: name -> part; only those of the rule are made.
        rules, compositions: compositions by name; the name of a rule stands for it alone, that of a composition also
            within longer ones.

    Raises:
        ValueError: a name is unknown, or the parts do not go together.

    >>> from metapp.learning.rules.parts import Betas, Rates
    >>> parts = {"rates": Rates(), "betas": Betas()}
    >>> compose("betas+rates", list(parts), parts.get, {}, {"adam": "rates+betas"}).name
    'adam'
    """

    def expand(word: str) -> set[str]:
        if word in names:
            return {word}
        inner = {**compositions, **rules}.get(word) if "+" not in word else word
        if inner is None:
            expected = ", ".join((*rules, *compositions, *names))
            raise ValueError(f"rule '{name}': '{word}' is unknown, expected names of these, joined by +: {expected}.")
        return {part for each in inner.split("+") for part in expand(each)}

    chosen = expand(name)
    short = {word: expand(word) for word in compositions if expand(word) <= chosen}
    rest = [part for part in names if part in chosen.difference(*short.values())]
    usual = next((rule for rule in rules if expand(rule) == chosen), "+".join([*short, *rest]))
    rule = LearnedRule(usual, tuple(part_of(part) for part in names if part in chosen))
    rates = [part.name for part in rule.parts if part.is_rate]
    if len(rates) != 1:
        kinds = ", ".join(part for part in names if part_of(part).is_rate)
        raise ValueError(
            f"rule '{usual}': {' and '.join(rates) or 'no part'} for rates, expected one of {kinds} "
            "(adam has rates, tied has shared)."
        )
    for part in rule.parts:
        if part.needs_one_of and not any(map(rule.has_part, part.needs_one_of)):
            raise ValueError(
                f"rule '{usual}': {part.name} says nothing by itself, expected {' or '.join(part.needs_one_of)} beside "
                "it; add that."
            )
    return rule
