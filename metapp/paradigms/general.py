"""General: an encoder, trained over all tasks, predicts the parameters in one forward pass; no steps."""

from __future__ import annotations

from torch import Generator

from metapp.learning.adjoint import Loss
from metapp.learning.draws import Rng, drawn
from metapp.learning.learn import MetaParameters, after_encoding, over_tasks, task_outer_loss
from metapp.learning.rules import fixed_adam
from metapp.learning.task import Params, Tasks
from metapp.paradigms.outer_loop import train
from metapp.paradigms.paradigm import Given, Job, Paradigm
from metapp.paradigms.resuming import Prepared


def start(job: Job, prepared: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
    """theta = encode(I)."""
    encoded = job.app.encode(prepared.encoder, drawn(job.app.condition, tasks, rng))
    return {key: value.detach() for key, value in encoded.items()}


def preparation(job: Job, rng: Generator) -> tuple[MetaParameters, Loss]:
    """The untrained encoder and the loss that trains it."""
    app, training = job.app, job.recipe.general
    loss = after_encoding(task_outer_loss(app, job.recipe.batch), app.condition, app.encode)
    augment = app.augment if training.augment else None
    return MetaParameters(encoder=app.init_encoder(rng)), over_tasks(loss, count=training.tasks, augment=augment)


def prepare(job: Job, given: Given) -> Prepared:
    """Train the encoder."""
    first, loss = preparation(job, given.rng)
    return train(GENERAL, job, first, loss, job.recipe.general, given)


GENERAL = Paradigm(
    name="general",
    needs=lambda job: ("general",),
    start=start,
    rule=lambda job, prepared, theta, steps: fixed_adam(job.recipe.finetune, theta, steps),
    steps=lambda recipe: 0,
    prepare=prepare,
)
