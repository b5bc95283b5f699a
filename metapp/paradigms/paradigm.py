"""Paradigms: an initialisation and a rule; `descend` is the same for all."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from torch import Generator

from metapp.learning.adjoint import Loss, StepsOf, UpdateRule, torch_steps
from metapp.learning.app import App
from metapp.learning.draws import Rng
from metapp.learning.guard import descend_guarded
from metapp.learning.learn import DescentState, MetaParameters, check_finite, descend, final_item, task_loss
from metapp.learning.recipe import Adam, Guard, OuterLoop, Recipe
from metapp.learning.rules import fixed_adam
from metapp.learning.task import Params, Tasks
from metapp.registry import registry

PARALLEL_TASKS = 8  # tasks that are fitted side by side where memory would grow with a data set
NO_OUTER_LOOP = OuterLoop(steps=0, tasks=0, rates={})


def fastest(*, compiles: bool = False) -> StepsOf:
    """The steps of an extension; torch's if there is none.

    Args:
        compiles: whether the steps are so many that compiling them pays.
    """
    entry = registry().hooks.get("steps")
    return functools.partial(entry.load(), compiles=compiles) if entry else torch_steps


@dataclass(frozen=True)
class Paradigm(ABC):
    """A way of training, for an application by a recipe; here for Adam from any initialisation.

    Attributes:
        app: the application.
        recipe: its settings.
        rule_name: Meta's rule, a name or a composition (`rules.rule_of`); "" at first for the recipe's.
        asked_steps: gradient steps instead of the recipe's number; None keeps that.
        guarding: whether the guard of learned rules is on.
        name: as on the command line.
        needs: checkpoints: of its initialisation ("general" or a rule), then of its tuning ("quickft").
    """

    app: App
    recipe: Recipe
    rule_name: str = ""
    asked_steps: int | None = None
    guarding: bool = True
    name: ClassVar[str]

    def __post_init__(self) -> None:
        object.__setattr__(self, "rule_name", self.rule_name or self.recipe.rule)

    @property
    def needs(self) -> tuple[str, ...]:
        """As the attributes say."""
        return ()

    @property
    @abstractmethod
    def recipe_steps(self) -> int:
        """The recipe's number of gradient steps."""

    @property
    def steps(self) -> int:
        """Number of gradient steps: 0 for General, whatever was asked for."""
        usual = self.recipe_steps
        return usual if self.asked_steps is None or usual == 0 else self.asked_steps

    @abstractmethod
    def initialisation(self, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        """Parameters [T, ...] before the first step."""

    def adam(self, phi: MetaParameters) -> Adam | None:
        """The plain Adam of the steps; None if the rule is a learned one, or there are no steps."""
        return None

    def rule(self, phi: MetaParameters, theta: Params, steps: int) -> UpdateRule:
        """The rule of so many steps from the initialisation `theta`."""
        adam = self.adam(phi)
        assert adam is not None
        return fixed_adam(adam, theta, steps)

    @property
    def loss(self) -> Loss:
        """The loss that the steps descend."""
        return task_loss(self.app, self.recipe.batch)

    @property
    def guard(self) -> Guard | None:
        """The guard of its fits; None if the rule is not learned."""
        return None

    # Training (`training.prepare`) of the last checkpoint that it needs

    @property
    def training(self) -> OuterLoop:
        """The outer loop; of 0 steps if there is none."""
        return NO_OUTER_LOOP

    @property
    def searched_from(self) -> Adam | None:
        """The first Adam of a search on validation tasks, before the outer loop; None for no search."""
        return None

    def first_phi(self, general: MetaParameters | None, tasks: Tasks, rng: Generator) -> MetaParameters:
        """phi before training.

        Args:
            general: a trained General, if there is one.
            tasks: training tasks.
            rng: of all random draws.

        Raises:
            ValueError: there is nothing to train.
        """
        raise ValueError(f"{self.name}: nothing to prepare.")

    def with_adam(self, phi: MetaParameters, adam: Adam) -> MetaParameters:
        """phi whose fits begin with an Adam of the search."""
        raise NotImplementedError

    def outer_loss(self, phi: MetaParameters) -> Loss:
        """The loss of the outer loop, on flat trees as of phi."""
        raise NotImplementedError

    def fit(self, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        """Fit tasks, one or many at once: the parameters of the network for each task, [T, ...]."""
        return final_item(self.descend(phi, tasks, rng)).theta

    def descend(self, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Iterator[DescentState]:
        """Fit tasks, one or many: descend from the initialisation by the rule, one step at a time.

        Args:
            phi: its checkpoint.
            tasks: one or many.
            rng: of all random draws; one for all tasks, or one for each, which is then fitted as if it were alone.

        Yields:
            The fit before its first step and after each; a learned rule's guard may add a last one.

        Raises:
            FloatingPointError: a loss is not finite; names the tasks and the step.
        """
        theta, steps = self.initialisation(phi, tasks, rng), self.steps
        if steps == 0:
            yield DescentState(0, theta, {})
            return
        rule, loss, guard = self.rule(phi, theta, steps), self.loss, self.guard if self.guarding else None
        if guard:
            yield from descend_guarded(theta, rule, tasks, loss, rng=rng, guard=guard, steps=steps, steps_of=fastest())
        else:
            yield from check_finite(descend(theta, rule, tasks, loss, steps=steps, rng=rng, steps_of=fastest()))

    def unguarded(self, steps: int | None = None) -> Self:
        """The same without a guard, for so many steps."""
        return replace(self, guarding=False, asked_steps=self.asked_steps if steps is None else steps)
