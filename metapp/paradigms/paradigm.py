"""What a way of training is: an initialisation and a rule; `fit` is the same learn for all."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from torch import Generator

from metapp.learning.adjoint import UpdateRule
from metapp.learning.app import App
from metapp.learning.deadline import Deadline
from metapp.learning.draws import Rng
from metapp.learning.guard import Guarded, learn_guarded, unguarded
from metapp.learning.learn import MetaParameters, Watch, learn, task_loss
from metapp.learning.recipe import Adam, Guard, Recipe
from metapp.learning.rules import fixed_adam
from metapp.learning.task import Params, Tasks
from metapp.paradigms.resuming import Keep, Prepared, Reached, forget

Report = Callable[[int, int, str], None]  # (step, steps, note), for a progress bar
AT_ONCE = 8  # tasks that are fitted side by side where memory would grow with a data set


class Job(NamedTuple):
    """What is fitted and how.

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


class Given(NamedTuple):
    """What a preparation works on.

    Attributes:
        to_fit, to_validate: the training tasks, and those of them that validate.
        rng: of all random draws.
        encoder: a prepared General; QuickFT tunes on it, Meta starts from it or from the mean of its predictions.
        steps: outer steps instead of the recipe's; validations where there is only a search.
        report: called with the progress.
        since: how far the same preparation was when it was cut off, to go on from.
        keep: called with how far it is, before each outer step and after each validation of a search.
    """

    to_fit: Tasks
    to_validate: Tasks
    rng: Generator
    encoder: MetaParameters | None = None
    steps: int | None = None
    report: Report | None = None
    since: Reached = Reached()
    keep: Keep = forget


def nothing(job: Job, given: Given) -> Prepared:
    """The preparation of a paradigm that needs none."""
    raise ValueError("nothing to prepare.")


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
        start: (job, prepared, tasks, rng) -> parameters [T, ...] before the first step.
        rule: (job, prepared, start, steps) -> how the steps move them.
        steps: recipe -> number of gradient steps.
        prepare: (job, given) -> the last of what it needs; the others are given.
        adam: (job, prepared) -> the plain Adam that it fits by; None where the rule is a learned one, or there is none.
        guard: job -> what guards its fits; None where the rule is none that was learned.
    """

    name: str
    needs: Callable[[Job], tuple[str, ...]]
    start: Callable[[Job, MetaParameters, Tasks, Rng], Params]
    rule: Callable[[Job, MetaParameters, Params, int], UpdateRule]
    steps: Callable[[Recipe], int]
    prepare: Callable[[Job, Given], Prepared] = nothing
    adam: Callable[[Job, MetaParameters], Adam | None] = lambda job, prepared: None
    guard: Callable[[Job], Guard | None] = lambda job: None

    def fit(self, job: Job, prepared: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        """Fit tasks, one or many at once.

        Returns:
            The network's parameters for each task, [T, ...].
        """
        return self.fitted(job, prepared, tasks, rng).theta

    def fitted(
        self,
        job: Job,
        prepared: MetaParameters,
        tasks: Tasks,
        rng: Rng,
        watch: Watch | None = None,
        deadline: Deadline | None = None,
    ) -> Guarded:
        """Fit tasks: learn(start(task), rule, task, loss, steps); and say where the guard of a learned rule acted.

        Args:
            job, prepared: what fits.
            tasks: one or many.
            rng: of all random draws; one for all tasks, or one for each, which is then fitted as if it were alone.
            watch: as of `learn`.
            deadline: when to be done: schedules end with the last step that fits.
        """
        theta = self.start(job, prepared, tasks, rng)
        if deadline is not None:
            job = job._replace(steps=deadline.plan(self.count(job)))
        steps, guard = self.count(job), self.guard(job)
        if steps == 0:
            return unguarded(theta)
        loss, rule = task_loss(job.app, job.recipe.batch), self.rule(job, prepared, theta, steps)
        if guard is None:
            enough = deadline.reached if deadline else None
            return unguarded(learn(theta, rule, tasks, loss, steps=steps, rng=rng, watch=watch, enough=enough))
        return learn_guarded(
            theta, rule, tasks, loss, steps=steps, rng=rng, guard=guard, watch=watch, deadline=deadline
        )

    def count(self, job: Job) -> int:
        """Return the number of gradient steps of this job: 0 for General, whatever was asked for."""
        usual = self.steps(job.recipe)
        return usual if job.steps is None or usual == 0 else job.steps
