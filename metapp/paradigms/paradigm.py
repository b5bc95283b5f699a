"""The contracts of a paradigm, by which tasks are fitted, and of the training of a checkpoint that fits read.

A fit needs an initialisation, a rule and a number of steps. A checkpoint needs a search, an outer loop, or both. No
code outside this package asks for a paradigm by its name: whatever differs between paradigms is a method or a
property here.
"""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Self

from torch import Generator

from metapp.learning.adjoint import Loss, StepMaker, UpdateRule, torch_steps
from metapp.learning.app import App
from metapp.learning.guard import descend_with_guard
from metapp.learning.learn import DescentState, MetaParameters, check_finite_losses, descend, final_item, task_loss
from metapp.learning.random_tensors import Rng
from metapp.learning.recipe import Adam, Guard, OuterLoop, Recipe
from metapp.learning.rules import fixed_adam
from metapp.learning.task import Params, Tasks
from metapp.registry import registry

PARALLEL_TASKS = 8  # tasks that are fitted at once in loops over a data set, which bounds the memory
NO_OUTER_LOOP = OuterLoop(steps=0, tasks=0, rates={})


def fastest_steps(*, compiles: bool = False) -> StepMaker:
    """Return the function that makes steps: an extension's if one is installed, else torch's.

    Args:
        compiles: whether the steps are so many that compiling them pays.
    """
    entry = registry().hooks.steps
    return functools.partial(entry.load(), compiles=compiles) if entry else torch_steps


@dataclass(frozen=True)
class Paradigm(ABC):
    """A way to fit tasks of an application by a recipe: an initialisation, a rule and a number of steps.

    Attributes:
        app: the application.
        recipe: the settings.
        steps: the number of gradient steps.
        name: the name on the command line.
        steps_field: the field of a recipe that holds the paradigm's number of steps; "" if it takes none.
        has_learned_rule: whether the rule is a learned one, which --rule names.
        takes_long: whether fits take so many steps that their results are stored to be read again; quick fits are
            repeated from a checkpoint instead.
    """

    app: App
    recipe: Recipe
    steps: int
    name: ClassVar[str]
    steps_field: ClassVar[str] = ""
    has_learned_rule: ClassVar[bool] = False
    takes_long: ClassVar[bool] = False

    @classmethod
    def of(cls, app: App, recipe: Recipe, rule: str = "", steps: int | None = None) -> Self:
        """Return the paradigm for an application by a recipe.

        Args:
            app: the application.
            recipe: the settings.
            rule: the name of a learned rule, "" for the recipe's default rule; paradigms without a learned rule ignore
                it.
            steps: the number of gradient steps, None for the recipe's number; General ignores it.
        """
        return cls(app, recipe, cls._steps(recipe, steps))

    @classmethod
    def _steps(cls, recipe: Recipe, requested: int | None) -> int:
        """Return the requested number of gradient steps, else the recipe's; always 0 if that is 0."""
        default: int = getattr(recipe, cls.steps_field) if cls.steps_field else 0
        return default if requested is None or default == 0 else requested

    @property
    def default_steps(self) -> int:
        """The number of gradient steps that the recipe gives the paradigm."""
        return self._steps(self.recipe, None)

    @property
    def trainings(self) -> tuple[CheckpointTraining, ...]:
        """The trainings of the checkpoints that fits read: of the initialisation, then of its tuning."""
        return ()

    @property
    def guard(self) -> Guard | None:
        """The guard of fits by a learned rule; None if the rule is not learned."""
        return None

    @property
    def loss(self) -> Loss:
        """The loss that the steps of a fit descend."""
        return task_loss(self.app, self.recipe.samples)

    def adam(self, phi: MetaParameters) -> Adam | None:
        """Return the plain Adam of the steps; None if the rule is a learned one, or if there are no steps."""
        return None

    @abstractmethod
    def initialisation(self, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        """Return the parameters [T, ...] before the first step."""

    def rule(self, phi: MetaParameters, theta: Params, steps: int) -> UpdateRule:
        """Return the update rule for a fit of some number of steps from the initialisation `theta`."""
        adam = self.adam(phi)
        assert adam is not None
        return fixed_adam(adam, theta, steps)

    def fit(self, phi: MetaParameters, tasks: Tasks, rng: Rng, *, guarded: bool = True) -> Params:
        """Fit tasks, one or many at once, and return the parameters of the network of each task, [T, ...].

        See :meth:`descend` for the arguments.
        """
        return final_item(self.descend(phi, tasks, rng, guarded=guarded)).theta

    def descend(self, phi: MetaParameters, tasks: Tasks, rng: Rng, *, guarded: bool = True) -> Iterator[DescentState]:
        """Fit tasks, one or many at once: descend from the initialisation by the rule, one step at a time.

        Args:
            phi: the parameters of the checkpoint.
            tasks: the tasks.
            rng: the source of all random numbers, one for all tasks or one for each. With one for each, a task is
                fitted as if it were alone.
            guarded: whether the guard of a learned rule looks at the fits.

        Yields:
            The state before the first step, and after each step; the guard of a learned rule adds one more with its
            results.

        Raises:
            FloatingPointError: a loss is not finite; the message names the tasks and the step.
        """
        theta, steps = self.initialisation(phi, tasks, rng), self.steps
        if steps == 0:
            yield DescentState(0, theta, {})
            return
        rule, loss, guard = self.rule(phi, theta, steps), self.loss, self.guard if guarded else None
        if guard:
            yield from descend_with_guard(
                theta, rule, tasks, loss, rng=rng, guard=guard, steps=steps, make_steps=fastest_steps()
            )
        else:
            yield from check_finite_losses(
                descend(theta, rule, tasks, loss, steps=steps, rng=rng, make_steps=fastest_steps())
            )


@dataclass(frozen=True)
class CheckpointTraining(ABC):
    """The training of a checkpoint: a search of an Adam on validation tasks, an outer loop on training tasks, or both.

    Attributes:
        paradigm: the paradigm whose fits validate the checkpoint, with the recipe's number of steps.
    """

    paradigm: Paradigm

    @property
    def name(self) -> str:
        """The name of the checkpoint, from which its file is named; by default the paradigm's name."""
        return self.paradigm.name

    @property
    @abstractmethod
    def general(self) -> CheckpointTraining:
        """The training of General for the same application and recipe."""

    @property
    def begins_at_general(self) -> bool:
        """Whether the training begins at a trained General."""
        return False

    @property
    def takes_encoder_from_general(self) -> bool:
        """Whether the checkpoint holds hyperparameters alone, and fits take the encoder from General's checkpoint."""
        return False

    @property
    def shared_by_observations(self) -> bool:
        """Whether applications with equal networks, whose fits see other things, share the checkpoint."""
        return False

    @property
    def outer_loop(self) -> OuterLoop:
        """The settings of the outer loop, which has 0 steps if there is none."""
        return NO_OUTER_LOOP

    @property
    def first_adam(self) -> Adam | None:
        """The Adam at which a search on validation tasks begins, before the outer loop; None for no search."""
        return None

    @abstractmethod
    def first_phi(self, general: MetaParameters | None, tasks: Tasks, rng: Generator) -> MetaParameters:
        """Return phi before training.

        Args:
            general: a trained General; None if there is none.
            tasks: the training tasks.
            rng: the source of all random numbers.
        """

    @abstractmethod
    def template(self, phi: MetaParameters) -> MetaParameters:
        """Return untrained parameters with the names and shapes that phi must have in this checkpoint."""

    def with_adam(self, phi: MetaParameters, adam: Adam) -> MetaParameters:
        """Return phi whose fits begin with an Adam that the search tries."""
        raise NotImplementedError

    def outer_loss(self, phi: MetaParameters) -> Loss:
        """Return the loss of the outer loop, on flat trees with phi's names."""
        raise NotImplementedError
