"""General: an encoder, trained over all tasks, predicts the parameters in one forward pass; no steps."""

from __future__ import annotations

from collections.abc import Iterator

from torch import Generator

from metapp.learning.adjoint import Loss
from metapp.learning.app import App
from metapp.learning.learn import Encoding, MetaParameters, after_encoding, over_tasks, staged, task_outer_loss
from metapp.learning.progress import Progress
from metapp.learning.rules import fixed_adam
from metapp.learning.task import Batch, Params, Rng, Tasks, drawn
from metapp.paradigms.outer_loop import train
from metapp.paradigms.paradigm import Job, Paradigm, TrainingData


def initialisation(job: Job, prepared: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
    """theta = encode(I)."""
    encoded = job.app.encode(prepared.encoder, drawn(job.app.condition, tasks, rng))
    return {key: value.detach() for key, value in encoded.items()}


def beginning(job: Job, prepared: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
    """The same where steps follow: beside it are the parameters that tasks give themselves and that it leaves out."""
    return job.app.known(tasks) | initialisation(job, prepared, tasks, rng)


def encoding(app: App) -> Encoding:
    """The encoding of `beginning`: its condition is that of General's encoder, and what tasks give themselves."""

    def condition(tasks: Tasks, rng: Generator) -> tuple[Batch, Params]:
        return app.condition(tasks, rng), app.known(tasks)

    def encode(encoder: Params, condition: tuple[Batch, Params]) -> Params:
        return condition[1] | app.encode(encoder, condition[0])

    return Encoding(condition, encode)


def outer_problem(job: Job, rng: Generator) -> tuple[MetaParameters, Loss]:
    """The untrained encoder and the loss that trains it."""
    app, training = job.app, job.recipe.general
    loss = after_encoding(task_outer_loss(app, job.recipe.batch), Encoding(app.condition, app.encode))
    augment = app.augment if training.augment else None
    outer = over_tasks(loss, count=training.tasks, augment=augment)
    # staged before tasks are augmented: what is not seen need not be made
    return MetaParameters(encoder=app.init_encoder(rng)), staged(outer, app.stage)


def prepare(job: Job, data: TrainingData) -> Iterator[Progress]:
    """Train the encoder."""
    phi, loss = outer_problem(job, data.rng)
    return train(GENERAL, job, data.first if data.first.encoder else phi, loss, job.recipe.general, data)


GENERAL = Paradigm(
    name="general",
    needs=lambda job: ("general",),
    initialisation=initialisation,
    rule=lambda job, prepared, theta, steps: fixed_adam(job.recipe.finetune, theta, steps),
    steps=lambda recipe: 0,
    prepare=prepare,
)
