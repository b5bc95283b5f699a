"""General: an encoder, trained over all tasks, predicts the parameters in one forward pass; no steps."""

from __future__ import annotations

from torch import Generator

from metapp.learning.adjoint import Loss
from metapp.learning.app import App
from metapp.learning.draws import Rng, draw_per_task
from metapp.learning.learn import Encoding, MetaParameters, after_encoding, over_tasks, task_outer_loss, with_stages
from metapp.learning.recipe import OuterLoop
from metapp.learning.task import Batch, Params, Tasks
from metapp.paradigms.paradigm import Paradigm


class General(Paradigm):
    """theta = encode(I), without a step."""

    name = "general"

    @property
    def needs(self) -> tuple[str, ...]:
        """The encoder."""
        return ("general",)

    @property
    def recipe_steps(self) -> int:
        """None."""
        return 0

    @property
    def training(self) -> OuterLoop:
        """The encoder's."""
        return self.recipe.general

    def initialisation(self, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        """The encoder's prediction; if steps follow, with the parameters that tasks give themselves."""
        return (self.app.known(tasks) if self.recipe_steps else {}) | predict(self.app, phi, tasks, rng)

    def first_phi(self, general: MetaParameters | None, tasks: Tasks, rng: Generator) -> MetaParameters:
        """An untrained encoder."""
        return MetaParameters(encoder=self.app.init_encoder(rng))

    def outer_loss(self, phi: MetaParameters) -> Loss:
        """The loss of the encoder's predictions."""
        app, training = self.app, self.recipe.general
        loss = after_encoding(task_outer_loss(app, self.recipe.batch), Encoding(app.condition, app.encode))
        outer = over_tasks(loss, count=training.tasks, augment=app.augment if training.augment else None)
        # staged before tasks are augmented: what is not seen need not be made
        return with_stages(outer, app.stage)


def predict(app: App, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
    """encode(I), the parameters that an encoder predicts of tasks, [T, ...]."""
    encoded = app.encode(phi.encoder, draw_per_task(app.condition, tasks, rng))
    return {key: value.detach() for key, value in encoded.items()}


def encoding(app: App) -> Encoding:
    """General's prediction, with the parameters that tasks give themselves, as a function of tasks."""

    def condition(tasks: Tasks, rng: Generator) -> tuple[Batch, Params]:
        return app.condition(tasks, rng), app.known(tasks)

    def encode(encoder: Params, condition: tuple[Batch, Params]) -> Params:
        return condition[1] | app.encode(encoder, condition[0])

    return Encoding(condition, encode)
