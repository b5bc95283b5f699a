"""Paradigms: an initialisation and a rule; `descend` is the same for all."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from torch import Generator

from metapp.learning.adjoint import Loss, UpdateRule, fastest
from metapp.learning.app import App
from metapp.learning.guard import descend_guarded
from metapp.learning.learn import MetaParameters, Step, checked, descend, last, task_loss
from metapp.learning.progress import Progress
from metapp.learning.recipe import Adam, Guard, Recipe
from metapp.learning.rules import fixed_adam
from metapp.learning.task import Params, Rng, Tasks

AT_ONCE = 8  # tasks that are fitted side by side where memory would grow with a data set


class Job(NamedTuple):
    """The application of a fit, and its settings.

    Attributes:
        app: the application.
        recipe: its settings.
        rule: Meta's learned rule, a name or a composition (`rules.rule_of`).
        steps: gradient steps instead of the recipe's number; None keeps that.
    """

    app: App
    recipe: Recipe
    rule: str
    steps: int | None = None


class TrainingData(NamedTuple):
    """The tasks of a preparation, its random numbers, and its beginning.

    Attributes:
        to_fit, to_validate: the training tasks, and those of them that validate.
        rng: of all random draws.
        encoder: a prepared General; QuickFT tunes on it, Meta begins with it or with the mean of its predictions.
        steps: outer steps instead of the recipe's; validations where there is only a search.
        since: how far the same preparation was when it was cut off, to go on from.
        first: a checkpoint of the same kind whose outer steps go on, in place of a fresh phi; {} for none.
    """

    to_fit: Tasks
    to_validate: Tasks
    rng: Generator
    encoder: MetaParameters | None = None
    steps: int | None = None
    since: Progress = Progress()
    first: MetaParameters = MetaParameters()


def nothing(job: Job, data: TrainingData) -> Iterator[Progress]:
    """The preparation of a paradigm that needs none."""
    raise ValueError("nothing to prepare.")


def plain_loss(job: Job) -> Loss:
    """The application's own loss."""
    return task_loss(job.app, job.recipe.batch)


PlainAdam = Callable[[Job, MetaParameters], Adam]


def by_adam(adam: PlainAdam) -> Callable[[Job, MetaParameters, Params, int], UpdateRule]:
    """Make the rule of a paradigm that fits by a plain Adam."""
    return lambda job, prepared, theta, steps: fixed_adam(adam(job, prepared), theta, steps)


class Paradigm(NamedTuple):
    """A way of training.

    Attributes:
        name: as on the command line.
        needs: job -> names of what must be prepared: what it fits from ("general" or a rule), then what is tuned for
            that ("quickft"); () for nothing.
        initialisation: (job, prepared, tasks, rng) -> parameters [T, ...] before the first step.
        rule: (job, prepared, initialisation, steps) -> how the steps move them.
        steps: recipe -> number of gradient steps.
        prepare: (job, training data) -> how far the preparation is of the last of what it needs, again and again; the
            others are given.
        adam: (job, prepared) -> the plain Adam that it fits by; None where the rule is a learned one, or there is none.
        guard: job -> what guards its fits; None where the rule is none that was learned.
        loss: job -> what the steps descend.
    """

    name: str
    needs: Callable[[Job], tuple[str, ...]]
    initialisation: Callable[[Job, MetaParameters, Tasks, Rng], Params]
    rule: Callable[[Job, MetaParameters, Params, int], UpdateRule]
    steps: Callable[[Recipe], int]
    prepare: Callable[[Job, TrainingData], Iterator[Progress]] = nothing
    adam: Callable[[Job, MetaParameters], Adam | None] = lambda job, prepared: None
    guard: Callable[[Job], Guard | None] = lambda job: None
    loss: Callable[[Job], Loss] = plain_loss

    def fit(self, job: Job, prepared: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        """Fit tasks, one or many at once: the parameters of the network for each task, [T, ...]."""
        return last(self.descend(job, prepared, tasks, rng)).theta

    def descend(self, job: Job, prepared: MetaParameters, tasks: Tasks, rng: Rng) -> Iterator[Step]:
        """Fit tasks, one or many: descend from initialisation(task) by the rule, one step at a time.

        Args:
            job, prepared: what fits.
            tasks: one or many.
            rng: of all random draws; one for all tasks, or one for each, which is then fitted as if it were alone.

        Yields:
            Where the fit is before its first step and after each; a learned rule's guard may add a last one.

        Raises:
            FloatingPointError: a loss is not finite; names the tasks and the step.
        """
        theta = self.initialisation(job, prepared, tasks, rng)
        steps, guard = self.count(job), self.guard(job)
        if steps == 0:
            yield Step(0, theta, {})
            return
        rule, loss = self.rule(job, prepared, theta, steps), self.loss(job)
        if guard:
            yield from descend_guarded(theta, rule, tasks, loss, rng=rng, guard=guard, steps=steps, engine=fastest())
        else:
            yield from checked(descend(theta, rule, tasks, loss, steps=steps, rng=rng, engine=fastest()))

    def count(self, job: Job) -> int:
        """Return the number of gradient steps of this job: 0 for General, whatever was asked for."""
        usual = self.steps(job.recipe)
        return usual if job.steps is None or usual == 0 else job.steps
