"""The outer loop: train on the training tasks, keep the best state on the validation tasks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import torch

from metapp.learning.adjoint import Loss
from metapp.learning.learn import MetaParameters, checked, descend
from metapp.learning.progress import TrainState
from metapp.learning.recipe import OuterLoop
from metapp.learning.rules import outer_adam
from metapp.paradigms import ranks
from metapp.paradigms.paradigm import Paradigm, TrainingData
from metapp.paradigms.validation import validation_error


def train(
    paradigm: Paradigm, first: MetaParameters, loss: Loss, training: OuterLoop, data: TrainingData
) -> Iterator[TrainState]:
    """Train a checkpoint by the outer loop and keep its best state on the validation tasks.

    Args:
        paradigm: whose fits validate.
        first: phi before the first outer step.
        loss: on phi, in its flat tree.
        training: settings of the loop; `data.steps` goes before its own.
        data: tasks, generator, and how far an earlier training was.

    Yields:
        Its state, before each outer step and after each validation; at the end there is one.

    Raises:
        FloatingPointError: the training loss is not finite; names tasks and step.
    """
    rng, since = data.rng, data.since
    if data.steps is not None:
        training = replace(training, steps=data.steps)
    # the best of a search is where the outer loop begins, not what it competes with
    state = since if since.outer else TrainState(since.errors, phi=first)
    losses = list(since.losses)
    if since.rng is not None:
        rng.set_state(since.rng)
    if ranks.count() > 1:
        ranks.require(min(training.tasks, len(data.to_fit)))
        loss = ranks.SummedOverRanks(loss.draw, loss.value, loss.shared)
    phi = first.flat()
    rule, steps = outer_adam(training, phi), training.steps
    descent = descend(phi, rule, data.to_fit, loss, steps=steps, rng=rng, since=since.outer)
    for now in checked(descent, every=1):
        losses += [] if now.loss is None else [now.loss.mean()]
        state = state._replace(
            outer=now, rng=rng.get_state(), losses=tuple(losses), done=now.step, total=steps, note=""
        )
        yield state
        if state.curve[-1:] and state.curve[-1][0] == now.step:
            continue  # it was cut off after this validation
        if now.step == steps or now.step % training.validate_every == 0:
            error = validation_error(paradigm, MetaParameters.unflat(now.theta), data.to_validate)
            mean = paradigm.app.scale * float(torch.stack(losses).mean()) if losses else None
            losses.clear()
            state = state._replace(losses=(), curve=(*state.curve, (now.step, mean, error)))
            if error < state.validation:
                best = MetaParameters.unflat({key: value.clone() for key, value in now.theta.items()})
                state = state._replace(phi=best, validation=error, best_step=now.step)
            note = f"validation {error:.3f}, best {state.validation:.3f}"
            yield state._replace(note=note if mean is None else f"loss {mean:.3f}, {note}")
