"""The training of phi, the parameters of a checkpoint: a search of an Adam, an outer loop, or both.

The states of a training are yielded one by one, so that the caller can show progress, write them to a file and
continue an interrupted training. Files, and which checkpoint is trained, are the caller's business.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Generator, Tensor

from metapp.learning.app import App
from metapp.learning.learn import DescentState, MetaParameters, check_finite_losses, descend
from metapp.learning.recipe import Adam, OuterLoop
from metapp.learning.rules import outer_adam
from metapp.learning.task import Params, Tasks
from metapp.paradigms import ranks
from metapp.paradigms.methods import PARALLEL_TASKS, fastest_steps, fit_tasks
from metapp.paradigms.trainings import Training


class TrainState(NamedTuple):
    """The state of a training between two steps, from which it can be continued; the last one is the result.

    Attributes:
        current: the present phi, a flat tree.
        rng: the state of the random generator, uint8.
        moments: the state of the outer Adam; {} before the outer loop.
        step: the number of outer steps that were taken; during a search, of Adams that were tried.
        losses: the training losses since the last validation, [n].
        searched: the validation errors of the Adams that were tried, in the order of the search.
        best: the phi with the lowest validation error, a flat tree.
        validation: the validation error of `best`: the mean over validation tasks, scaled like in tables.
        best_step: the step of `best`.
        curve: for each validation the step, the mean training loss since the validation before (None without outer
            steps), and the validation error, scaled like in tables. In a search, only for Adams that are better than
            all before.
        total: the number of steps at the end.
        note: a line about the validation that was just made; "" for none.
    """

    current: Params
    rng: Tensor
    moments: Params = {}  # noqa: RUF012  (never written to)
    step: int = 0
    losses: Tensor = torch.empty(0)
    searched: tuple[float, ...] = ()
    best: Params = {}  # noqa: RUF012
    validation: float = float("inf")
    best_step: int = 0
    curve: tuple[tuple[int, float | None, float], ...] = ()
    total: int = 0
    note: str = ""

    @property
    def phi(self) -> MetaParameters:
        """The phi with the lowest validation error."""
        return MetaParameters.unflatten(self.best)


Validate = Callable[[Training, MetaParameters, Tasks], float]  # returns the error of fits of tasks from a phi


def validation_error(training: Training, phi: MetaParameters, tasks: Tasks) -> float:
    """Return the mean error of fits of all tasks, scaled like in tables; infinite if a fit diverges.

    Seeds are fixed: one is enough where fits are deterministic, else two are averaged. All kinds of tasks weigh alike.
    Learned rules fit without their guard, so that the best rule is kept and not the best fallback.
    """
    app, method = training.app, training.method(phi)._replace(guard=None)
    total, weights, seeds = 0.0, tasks.kind_weights(), 1 if app.deterministic else 2
    for seed in range(seeds):
        rng = Generator(tasks.rows.device).manual_seed(seed)
        for rows in torch.arange(len(tasks)).split(PARALLEL_TASKS):
            selected_tasks = tasks.select(rows)
            try:
                theta = fit_tasks(method, selected_tasks, rng)
            except FloatingPointError:
                return float("inf")
            total += float((weights[rows] * app.errors(theta, selected_tasks)["error"]).sum())
    return app.error_measure.scale * total / (seeds * float(weights.sum()))


def train_phi(
    training: Training,
    tasks: Tasks,
    rng: Generator,
    *,
    general: MetaParameters | None = None,
    first: MetaParameters | None = None,
    steps: int | None = None,
    since: TrainState | None = None,
    validate: Validate = validation_error,
) -> Iterator[TrainState]:
    """Train the phi of a checkpoint.

    Args:
        training: the initial phi, the outer loss and the settings of the training.
        tasks: the training tasks, of which every eighth group validates.
        rng: the source of all random numbers.
        general: a trained General, at which QuickFT and most recipes of Meta begin.
        first: a trained phi of the same kind, which outer steps continue to train in place of a fresh phi.
        steps: the number of outer steps, in place of the recipe's number; without an outer loop the greatest number of
            Adams to try.
        since: a state of the same training, which is continued; `first` and `general` are then not read.
        validate: a function that returns the error of fits of validation tasks, by which the best state is chosen.

    Yields:
        The state after each Adam that was tried, before the outer loop, after each outer step, and after each
        validation. The last state is the result.

    Raises:
        ValueError: the tasks have fewer than 4 groups.
        FloatingPointError: the training loss is not finite; the message names tasks and step.
    """
    training_tasks, validation_tasks = split_validation(tasks)
    outer_loop, adam = training.outer_loop, training.first_adam
    if since:
        rng.set_state(since.rng)
    state = since or TrainState((first or training.first_phi(general, training_tasks, rng)).flatten(), rng.get_state())
    if adam and not first and not state.moments:
        # where outer steps follow, `steps` is their number, and does not limit the search
        for search_state in _search_adam(
            training, adam, state, validation_tasks, validate, None if outer_loop.steps else steps
        ):
            yield search_state
        if not outer_loop.steps:
            return
        # the outer loop begins at the best Adam of the search, and forgets its error: validations of outer steps are
        # compared with each other alone
        state = TrainState(search_state.best, search_state.rng, searched=search_state.searched)
    outer_loop = outer_loop if steps is None else replace(outer_loop, steps=steps)
    if outer_loop.validation_variants:
        rows = list(range(len(validation_tasks))) * outer_loop.validation_variants
        variants_rng = Generator(tasks.rows.device).manual_seed(0)
        validation_tasks = training.app.augment(validation_tasks.select(rows), variants_rng)
    yield from _run_outer_loop(training, outer_loop, state, training_tasks, validation_tasks, rng, validate)


def _run_outer_loop(
    training: Training,
    outer_loop: OuterLoop,
    state: TrainState,
    training_tasks: Tasks,
    validation_tasks: Tasks,
    rng: Generator,
    validate: Validate,
) -> Iterator[TrainState]:
    """Take outer steps, and validate before the first one, at intervals, and after the last one."""
    steps = outer_loop.steps
    descents = _descend_outer_loss(training, outer_loop, state, training_tasks, rng)
    for descent in check_finite_losses(descents, every=1):
        losses = state.losses
        if descent.loss is not None:
            losses = torch.cat([losses.to(descent.loss), descent.loss.mean()[None]])
        state = state._replace(
            current=descent.theta,
            moments=descent.rule_state,
            rng=rng.get_state(),
            losses=losses,
            step=descent.step,
            total=steps,
            note="",
        )
        yield state
        if state.curve[-1:] and state.curve[-1][0] == descent.step:
            continue  # the training was interrupted after this validation
        if descent.step == steps or descent.step % outer_loop.validate_every == 0:
            error = validate(training, MetaParameters.unflatten(descent.theta), validation_tasks)
            mean = training.app.error_measure.scale * float(losses.mean()) if len(losses) else None
            state = state._replace(losses=losses[:0], curve=(*state.curve, (descent.step, mean, error)))
            if error < state.validation:
                best = {key: value.clone() for key, value in descent.theta.items()}
                state = state._replace(best=best, validation=error, best_step=descent.step)
            note = f"validation {error:.3f}, best {state.validation:.3f}"
            yield state._replace(note=note if mean is None else f"loss {mean:.3f}, {note}")


def _descend_outer_loss(
    training: Training, outer_loop: OuterLoop, state: TrainState, tasks: Tasks, rng: Generator
) -> Iterator[DescentState]:
    """Descend the outer loss by the Adam of the outer loop, in the ranks that there are."""
    since = DescentState(state.step, state.current, state.moments) if state.moments else None
    assert training.outer_loss is not None
    loss = training.outer_loss(MetaParameters.unflatten(state.current))
    if ranks.rank_count() > 1:
        loss = ranks.LossOverRanks(loss.draw, loss.value, loss.shared)
    rule, make_steps = outer_adam(outer_loop, state.current), fastest_steps()
    return descend(
        state.current, rule, tasks, loss, steps=outer_loop.steps, rng=rng, since=since, make_steps=make_steps
    )


MAX_SEARCH_TASKS = 8  # validation tasks of a search, unless networks are small
SMALL_NETWORK_PARAMETERS = 2**16  # up to which a search can afford to fit all tasks of applications with small tensors


def _search_adam(
    training: Training, first: Adam, state: TrainState, tasks: Tasks, validate: Validate, most: int | None
) -> Iterator[TrainState]:
    """Search an Adam by changing one setting or two at a time, from an Adam on.

    Args:
        training: the checkpoint's training, which applies an Adam to phi.
        first: the Adam that is tried first.
        state: the state before the search, or of an interrupted search, whose validation errors are not computed again.
        tasks: the validation tasks.
        validate: a function that returns the error of fits.
        most: the greatest number of Adams to try; None for no limit.

    Yields:
        The state after each Adam; after an interruption beginning with the last one whose error is known.
    """
    assert training.with_adam is not None
    known_errors, phi = state.searched, MetaParameters.unflatten(state.current)
    tasks = _select_search_tasks(training.app, tasks)
    total = min(1 + sum(map(len, training.search)), most or sys.maxsize)
    state, best = TrainState(state.current, state.rng, total=total), first
    errors: list[float] = []

    def candidates() -> Iterator[Adam]:
        """Yield the Adams to try: the first one, then each line of changes around the best one so far."""
        yield best
        for line in training.search:
            centre = best
            for changes in line[: total - len(errors)]:
                yield replace(centre, **{**changes, "rate": centre.rate * changes.get("rate", 1.0)})

    for step, adam in enumerate(candidates(), 1):
        candidate = training.with_adam(phi, adam)
        error = known_errors[step - 1] if step <= len(known_errors) else validate(training, candidate, tasks)
        errors.append(error)
        state = state._replace(searched=tuple(errors), step=step)
        if error < state.validation:
            curve, best = (*state.curve, (step, None, error)), adam
            state = state._replace(best=candidate.flatten(), validation=error, best_step=step, curve=curve)
        if step >= len(known_errors):
            yield state._replace(note=f"rate {adam.rate:.1e}, validation {error:.3f}, best {state.validation:.3f}")


def _select_search_tasks(app: App, tasks: Tasks) -> Tasks:
    """Return all validation tasks if networks are small, else up to MAX_SEARCH_TASKS of them, evenly spaced."""
    if app.small_tensors:
        theta = app.init(Generator().manual_seed(0), 1)
        if sum(parameter.numel() for parameter in theta.values()) <= SMALL_NETWORK_PARAMETERS:
            return tasks
    count = min(len(tasks), MAX_SEARCH_TASKS)
    return tasks.select([i * len(tasks) // count for i in range(count)])


def split_validation(tasks: Tasks) -> tuple[Tasks, Tasks]:
    """Split tasks into tasks to train on and tasks to validate on.

    Of the groups, sorted by name, every eighth validates, beginning with the fourth. Sorting spreads the validation
    tasks over the families that names begin with.

    Raises:
        ValueError: there are fewer than 4 groups.

    >>> train, validate = split_validation(Tasks(tuple("abcdef"), {}, torch.arange(6)))
    >>> train.selected_names, validate.selected_names
    (('a', 'b', 'c', 'e', 'f'), ('d',))
    """
    groups = [(tasks.groups or tasks.names)[row] for row in tasks.rows.tolist()]
    if len(set(groups)) < 4:
        raise ValueError(
            f"training set: {len(tasks)} tasks that show {len(set(groups))} things, expected at least 4 (some are kept "
            "for validation)."
        )
    validation_groups = set(sorted(set(groups))[3::8])
    rows = range(len(tasks))
    return (
        tasks.select([row for row in rows if groups[row] not in validation_groups]),
        tasks.select([row for row in rows if groups[row] in validation_groups]),
    )
