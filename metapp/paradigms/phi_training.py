"""The training of a checkpoint: a search of an Adam on validation tasks, an outer loop on training tasks, or both."""

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
from metapp.paradigms.paradigm import PARALLEL_TASKS, Paradigm, Preparation


class TrainState(NamedTuple):
    """The state of a training between two steps, which is saved and gone on from, and at the end its result.

    Attributes:
        current: phi now, a flat tree.
        rng: state of the generator of all draws, uint8.
        moments: state of the outer Adam; {} before the outer loop.
        step: outer steps taken; before the outer loop, Adams tried.
        losses: training losses since the last validation, [n].
        searched: validation errors of the Adams tried, in the order of the search.
        best: the phi of the lowest validation error, a flat tree.
        validation: its error, the mean over validation tasks as tables print it.
        best_step: the step that it is of.
        curve: (step, mean training loss since the last entry, validation error), scaled as in tables; None for no loss.
        total: number of steps at the end.
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
        """The best phi."""
        return MetaParameters.unflatten(self.best)


Validate = Callable[[Paradigm, MetaParameters, Tasks], float]


def validation_error(paradigm: Paradigm, phi: MetaParameters, tasks: Tasks) -> float:
    """The mean error of fits of all tasks with fixed seeds, as tables print it; infinite if a fit diverges.

    Kinds of tasks count alike. Learned rules fit without their guard: the best rule is kept, not the best fallback.
    """
    app = paradigm.app
    total, weights, seeds = 0.0, tasks.kind_weights(), 1 if app.deterministic else 2
    for seed in range(seeds):
        rng = Generator(tasks.rows.device).manual_seed(seed)
        for rows in torch.arange(len(tasks)).split(PARALLEL_TASKS):
            part = tasks.select(rows)
            try:
                theta = paradigm.fit(phi, part, rng, guarded=False)
            except FloatingPointError:
                return float("inf")
            total += float((weights[rows] * app.errors(theta, part)["error"]).sum())
    return app.error_measure.scale * total / (seeds * float(weights.sum()))


def train_phi(
    preparation: Preparation,
    tasks: Tasks,
    rng: Generator,
    *,
    general: MetaParameters | None = None,
    first: MetaParameters | None = None,
    steps: int | None = None,
    since: TrainState | None = None,
    validate: Validate = validation_error,
) -> Iterator[TrainState]:
    """Train a checkpoint.

    Args:
        preparation: of the checkpoint.
        tasks: training tasks; every eighth validates.
        rng: of all random draws.
        general: a trained General, which QuickFT and most recipes of Meta begin at.
        first: a checkpoint of the same kind whose outer steps go on, in place of a fresh phi.
        steps: outer steps in place of the recipe's; the most Adams to try if there is only a search.
        since: state of the same training when it was cut off; `first` and `general` are not read.
        validate: the error of a checkpoint's fits of validation tasks, by which the best state is chosen.

    Yields:
        Its state after each Adam tried, before and after each outer step, and after each validation; the last one is
        the result.

    Raises:
        ValueError: there are fewer than 4 tasks.
        FloatingPointError: the training loss is not finite; names tasks and step.
    """
    to_fit, to_validate = split_validation(tasks)
    training, adam = preparation.outer_loop, preparation.first_adam
    if since:
        rng.set_state(since.rng)
    state = since or TrainState((first or preparation.first_phi(general, to_fit, rng)).flatten(), rng.get_state())
    if adam and not first and not state.moments:
        # where outer steps follow, their number says nothing about the search
        for tried in _search(preparation, adam, state, to_validate, validate, None if training.steps else steps):
            yield tried
        if not training.steps:
            return
        # the best of a search is where the outer loop begins, not what it competes with
        state = TrainState(tried.best, tried.rng, searched=tried.searched)
    training = training if steps is None else replace(training, steps=steps)
    if training.validation_variants:
        rows = list(range(len(to_validate))) * training.validation_variants
        fixed = Generator(tasks.rows.device).manual_seed(0)
        to_validate = preparation.paradigm.app.augment(to_validate.select(rows), fixed)
    yield from _outer_loop(preparation, training, state, to_fit, to_validate, rng, validate)


def _outer_loop(
    preparation: Preparation,
    training: OuterLoop,
    state: TrainState,
    to_fit: Tasks,
    to_validate: Tasks,
    rng: Generator,
    validate: Validate,
) -> Iterator[TrainState]:
    """Outer steps, with a validation before the first, at the end, and every so many."""
    loss, steps = preparation.outer_loss(MetaParameters.unflatten(state.current)), training.steps
    if ranks.rank_count() > 1:
        loss = ranks.LossOverRanks(loss.draw, loss.value, loss.shared)
    rule, paradigm = outer_adam(training, state.current), preparation.paradigm
    since = DescentState(state.step, state.current, state.moments) if state.moments else None
    for now in check_finite_losses(
        descend(state.current, rule, to_fit, loss, steps=steps, rng=rng, since=since), every=1
    ):
        losses = state.losses
        if now.loss is not None:
            losses = torch.cat([losses.to(now.loss), now.loss.mean()[None]])
        state = state._replace(
            current=now.theta,
            moments=now.state,
            rng=rng.get_state(),
            losses=losses,
            step=now.step,
            total=steps,
            note="",
        )
        yield state
        if state.curve[-1:] and state.curve[-1][0] == now.step:
            continue  # it was cut off after this validation
        if now.step == steps or now.step % training.validate_every == 0:
            error = validate(paradigm, MetaParameters.unflatten(now.theta), to_validate)
            mean = paradigm.app.error_measure.scale * float(losses.mean()) if len(losses) else None
            state = state._replace(losses=losses[:0], curve=(*state.curve, (now.step, mean, error)))
            if error < state.validation:
                best = {key: value.clone() for key, value in now.theta.items()}
                state = state._replace(best=best, validation=error, best_step=now.step)
            note = f"validation {error:.3f}, best {state.validation:.3f}"
            yield state._replace(note=note if mean is None else f"loss {mean:.3f}, {note}")


MAX_SEARCH_TASKS = 8  # validation tasks, where a fit takes longer than an instant


def _search(
    preparation: Preparation, first: Adam, state: TrainState, tasks: Tasks, validate: Validate, most: int | None
) -> Iterator[TrainState]:
    """A coordinate search from an Adam on, one setting or two at a time; errors that `state` knows stay."""
    paradigm, known, phi = preparation.paradigm, state.searched, MetaParameters.unflatten(state.current)
    lines = paradigm.recipe.search
    tasks = _search_tasks(paradigm.app, tasks)
    total = min(1 + sum(map(len, lines)), most or sys.maxsize)
    state, best = TrainState(state.current, state.rng, total=total), first
    errors: list[float] = []

    def candidates() -> Iterator[Adam]:
        yield best
        for choices in lines:
            around = best
            for changes in choices[: total - len(errors)]:
                yield replace(around, **{**changes, "rate": around.rate * changes.get("rate", 1.0)})

    for step, adam in enumerate(candidates(), 1):
        tried = preparation.with_adam(phi, adam)
        error = known[step - 1] if step <= len(known) else validate(paradigm, tried, tasks)
        errors.append(error)
        state = state._replace(searched=tuple(errors), step=step)
        if error < state.validation:
            curve, best = (*state.curve, (step, None, error)), adam
            state = state._replace(best=tried.flatten(), validation=error, best_step=step, curve=curve)
        if step >= len(known):
            yield state._replace(note=f"rate {adam.rate:.1e}, validation {error:.3f}, best {state.validation:.3f}")


def _search_tasks(app: App, tasks: Tasks) -> Tasks:
    """All validation tasks if fits are cheap, else up to SEARCH_TASKS of them, evenly spaced."""
    if app.cheap_fits:
        return tasks
    count = min(len(tasks), MAX_SEARCH_TASKS)
    return tasks.select([i * len(tasks) // count for i in range(count)])


def split_validation(tasks: Tasks) -> tuple[Tasks, Tasks]:
    """The tasks to train on, and those to validate on: of the groups, sorted by name, every eighth from the fourth on.

    Sorting spreads the validation tasks over the families that names begin with.

    Raises:
        ValueError: fewer than 4 groups.

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
    validating = set(sorted(set(groups))[3::8])
    rows = range(len(tasks))
    return (
        tasks.select([row for row in rows if groups[row] not in validating]),
        tasks.select([row for row in rows if groups[row] in validating]),
    )
