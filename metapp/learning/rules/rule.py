"""Learned rules: parts that act one after the other as one update rule.

What is learned about a step is split into parts, so that rules can be composed, and an ablation can leave one out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from metapp.learning.adjoint import Loss, UpdateRule
from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.task import Params


class StepInput(NamedTuple):
    """The state of a step before the parameters move; each field holds tensors [T, ...] by the names of parameters.

    Only the gradients of the part `solve` have other names: see :class:`metapp.learning.rules.solve.NormalEquations`.

    Attributes:
        theta: the parameters.
        grads: the gradients that the loss returned.
        directions: the directions that all parts together made of the gradients, before any rate.
    """

    theta: Params
    grads: Params
    directions: Params


class Part:
    """A part of a learned rule: hyperparameters, and what they change at some points of a step.

    Methods that a part does not define change nothing. A step passes the gradients through :meth:`gradients` of all
    parts and the result through their :meth:`directions`. It passes the directions through :meth:`updates`, and
    subtracts the updates from the parameters; a parameter without an update stays. Last, it passes the new parameters
    through :meth:`after_step`. In these four methods `alpha` holds the hyperparameters of one step, with a task axis in
    place of the axis of steps.

    Parts of a rule share one dictionary of hyperparameters and one of memories, so that a part may read another's.
    Hence the names in both are unique among parts. Hyperparameters whose names begin with `loss.` are given to the
    application's loss, without this prefix. The four methods and :meth:`state` are pure functions of tensors: they are
    differentiated, and draw no random numbers. One part of a rule decides how far parameters move.

    Attributes:
        name: the name in messages.
        statistics_prefixes: beginnings of the names of hyperparameters that follow from statistics of gradients, which
            are computed on training tasks before the outer loop and before any search of an Adam.
    """

    name: str
    statistics_prefixes: tuple[str, ...] = ()

    def refusal(self, app: App, theta: Params) -> str:
        """Return why the part does not apply to an application; "" if it does.

        Args:
            app: the application.
            theta: parameters of one task.
        """
        return ""

    def initial(self, app: App, theta: Params, steps: int, adam: Adam) -> Params:
        """Return hyperparameters [K, ...] before training, equal to the settings of `adam` where it has such settings.

        Args:
            app: the application.
            theta: parameters of one task.
            steps: the number of steps of a fit. K is this number, or 1 for hyperparameters that all steps share.
            adam: settings of a plain Adam.
        """
        return {}

    def loss(self, app: App, loss: Loss) -> Loss:
        """Return the loss that steps descend in place of a given loss.

        Args:
            app: the application.
            loss: the application's own loss, or what a part before this one made of it.
        """
        return loss

    def state(self, alpha: Params, theta: Params) -> Params:
        """Return the part's memory before the first step, by name.

        Args:
            alpha: the hyperparameters of all steps, [K, ...], or [K, T, ...] if each task has its own.
            theta: the initialisation [T, ...].
        """
        return {}

    def gradients(self, alpha: Params, grads: Params) -> Params:
        """Transform gradients [T, ...], before directions are made of them.

        Args:
            alpha: the hyperparameters of this step, with a task axis.
            grads: the gradients, by the names of parameters.
        """
        return grads

    def directions(self, alpha: Params, directions: Params, state: Params) -> tuple[Params, Params]:
        """Transform directions, and return with them what the part remembers for the next step.

        What is not returned is forgotten.

        Args:
            alpha: the hyperparameters of this step, with a task axis.
            directions: gradients, or what parts before this one made of them, [T, ...].
            state: what all parts remember from the step before.
        """
        return directions, {}

    def updates(self, alpha: Params, updates: Params) -> Params:
        """Transform updates [T, ...], which are subtracted from the parameters.

        The first part gets the directions as updates.

        Args:
            alpha: the hyperparameters of this step, with a task axis.
            updates: the updates, by the names of parameters.
        """
        return updates

    def after_step(self, alpha: Params, theta: Params, before: StepInput, state: Params) -> tuple[Params, Params]:
        """Transform the parameters after the step, and return with them what the part remembers for the next step.

        Args:
            alpha: the hyperparameters of this step, with a task axis.
            theta: the parameters after the step, [T, ...].
            before: the state before the step.
            state: what all parts remember from the step before.
        """
        return theta, {}

    def for_steps(self, alpha: Params, steps: int) -> Params:
        """Return hyperparameters [K, ...] for a fit of this number of steps, whatever number they were trained for."""
        return alpha

    def gradient_statistics(self, alpha: Params, grads: Params) -> Params:
        """Return statistics of one step's gradients on training tasks, to be summed over steps and tasks.

        Args:
            alpha: hyperparameters [K, ...] before training.
            grads: gradients [T, ...].
        """
        return {}

    def from_statistics(self, alpha: Params, sums: Params) -> Params:
        """Return hyperparameters [K, ...] in which those with :attr:`statistics_prefixes` follow from statistics.

        Args:
            alpha: hyperparameters [K, ...] before training.
            sums: sums of the statistics that :meth:`gradient_statistics` returned.
        """
        return alpha


@dataclass(frozen=True)
class LearnedRule:
    """An update rule whose hyperparameters Meta learns.

    Attributes:
        name: the name of the rule in the registry.
        parts: the parts, in the order in which they act.
    """

    name: str
    parts: tuple[Part, ...]

    def check_app(self, app: App, theta: Params) -> None:
        """Refuse an application that a part does not apply to.

        Args:
            app: the application.
            theta: parameters of one task.

        Raises:
            ValueError: a part does not apply; the message names it and the reason.
        """
        for part in self.parts:
            if reason := part.refusal(app, theta):
                raise ValueError(
                    f"rule '{self.name}': its part {part.name} does not apply to {app.name}: {reason}; choose a rule "
                    "without it."
                )

    def initial_alpha(self, app: App, theta: Params, steps: int, adam: Adam) -> Params:
        """Return the hyperparameters [K, ...] before training.

        With them the rule is the plain Adam `adam`, or SGD of its rate. Two things differ: a rule that does not learn
        Adam's eps has an eps of META_EPS, and tail averaging replaces the last parameters by their mean.

        Args:
            app: the application.
            theta: parameters of one task.
            steps: the number of steps of a fit.
            adam: settings of a plain Adam.

        Raises:
            ValueError: a part does not apply to the application.
        """
        self.check_app(app, theta)
        example = next(iter(theta.values()))
        parts = (part.initial(app, theta, steps, adam) for part in self.parts)
        return {key: value.to(example) for initial in parts for key, value in initial.items()}

    def update_rule(self, alpha: Params) -> UpdateRule:
        """Return the update rule with hyperparameters [K, ...], or [K, T, ...] if each task has its own."""

        def init(theta: Params) -> Params:
            return {key: value for part in self.parts for key, value in part.state(alpha, theta).items()}

        return UpdateRule(alpha, init, self)

    def loss(self, app: App, loss: Loss) -> Loss:
        """Return the loss that steps of the rule descend in place of the application's own loss."""
        for part in self.parts:
            loss = part.loss(app, loss)
        return loss

    def __call__(self, alpha: Params, theta: Params, grads: Params, state: Params) -> tuple[Params, Params]:
        """Take one step; arguments and results are described at :class:`metapp.learning.adjoint.UpdateRule`."""
        directions = grads
        new_state: Params = {}
        for part in self.parts:
            directions = part.gradients(alpha, directions)
        for part in self.parts:
            directions, memory = part.directions(alpha, directions, state)
            new_state |= memory
        updates = directions
        for part in self.parts:
            updates = part.updates(alpha, updates)
        new_theta = {key: value - updates[key] if key in updates else value for key, value in theta.items()}
        for part in self.parts:
            new_theta, memory = part.after_step(alpha, new_theta, StepInput(theta, grads, directions), state)
            new_state |= memory
        return new_theta, new_state

    def for_steps(self, alpha: Params, steps: int) -> Params:
        """Return hyperparameters [K, ...] for a fit of this number of steps, whatever number they were trained for."""
        for part in self.parts:
            alpha = part.for_steps(alpha, steps)
        return alpha

    @property
    def statistics_prefixes(self) -> tuple[str, ...]:
        """Beginnings of the names of hyperparameters that are computed from statistics of gradients."""
        return tuple(prefix for part in self.parts for prefix in part.statistics_prefixes)

    def gradient_statistics(self, alpha: Params, grads: Params) -> Params:
        """Return statistics of one step's gradients on training tasks. See :meth:`Part.gradient_statistics`."""
        return {key: value for part in self.parts for key, value in part.gradient_statistics(alpha, grads).items()}

    def from_statistics(self, alpha: Params, sums: Params) -> Params:
        """Return hyperparameters of which some follow from statistics. See :meth:`Part.from_statistics`."""
        for part in self.parts:
            alpha = part.from_statistics(alpha, sums)
        return alpha
