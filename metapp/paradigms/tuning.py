"""The search of an Adam on validation tasks: QuickFT's, and what learned rules begin as."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Generator, Iterator
from dataclasses import replace

from metapp.learning.app import App
from metapp.learning.learn import MetaParameters
from metapp.learning.progress import TrainState
from metapp.learning.recipe import Adam
from metapp.learning.task import Tasks
from metapp.paradigms.paradigm import Paradigm, TrainingData
from metapp.paradigms.validation import validation_error


def search(
    paradigm: Paradigm, first: Adam, phi_of: Callable[[Adam], MetaParameters], data: TrainingData
) -> Generator[TrainState, None, TrainState]:
    """The best Adam on validation tasks: a coordinate search, one setting or two at a time.

    Args:
        paradigm: whose fits are judged.
        first: where the search begins.
        phi_of: what is fitted from with an Adam.
        data: validation tasks; `steps` is how many Adams are tried at most.

    Yields:
        How far it is after each Adam that no earlier search has tried.

    Returns:
        How far it is at the end.
    """
    tasks, earlier = to_tune_on(paradigm.app, data.to_validate), data.since.errors
    total = min(1 + sum(len(choices) for choices in SEARCHED), data.steps or sys.maxsize)
    state, best_adam = TrainState(phi=phi_of(first)), first
    errors: list[float] = []

    def candidates() -> Iterator[Adam]:
        yield best_adam
        for choices in SEARCHED:
            around = best_adam
            for changes in choices[: total - len(errors)]:
                yield replace(around, **{**changes, "rate": around.rate * changes.get("rate", 1.0)})

    for adam in candidates():
        phi, tried = phi_of(adam), len(errors)
        errors.append(earlier[tried] if tried < len(earlier) else validation_error(paradigm, phi, tasks))
        error, done = errors[-1], len(errors)
        state = state._replace(errors=tuple(errors), done=done, total=total)
        if error < state.validation:
            curve, best_adam = (*state.curve, (done, None, error)), adam
            state = state._replace(phi=phi, validation=error, best_step=done, curve=curve)
        if done >= len(earlier) and not data.since.outer:
            note = f"rate {adam.rate:.1e}, validation {error:.3f}, best {state.validation:.3f}"
            yield state._replace(note=note)
    return state


def to_tune_on(app: App, tasks: Tasks) -> Tasks:
    """All validation tasks where fits are cheap, else up to TUNED_ON of them, evenly spaced."""
    if app.cheap_fits:
        return tasks
    count = min(len(tasks), TUNED_ON)
    return tasks.select([i * len(tasks) // count for i in range(count)])


# What the search tries, one line after the other around the best so far; a rate is a factor of the best's.
TUNED_ON = 8  # validation tasks, where a fit takes longer than an instant
SEARCHED: tuple[list[dict[str, float]], ...] = (
    [{"rate": 2.0**i} for i in (-1, 1, -2, 2, -3, 3, -4, 4, -5, 5)],
    [
        {"beta1": beta1, "beta2": beta2}
        for beta1, beta2 in itertools.product((0.3, 0.5, 0.7, 0.8, 0.9), (0.8, 0.9, 0.97, 0.99, 0.999))
    ],
    [{"final": final, "rate": factor} for final, factor in itertools.product((1.0, 0.3, 0.1, 0.0), (1.0, 1.3))],
    [{"eps": eps, "rate": factor} for eps, factor in itertools.product((1e-8, 1e-6, 1e-4, 1e-3), (0.84, 1.0, 1.19))],
    [{"rate": 2 ** (i / 8)} for i in (-5, -3, -2, -1, 1, 2, 3, 5)],
)
