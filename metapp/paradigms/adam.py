"""The paradigms without a learned rule: a plain Adam from random parameters, or from an encoder's prediction."""

from __future__ import annotations

import torch
from torch import Generator

from metapp.learning.adjoint import Loss
from metapp.learning.app import App
from metapp.learning.draws import Rng, draw_per_task
from metapp.learning.learn import Encoding, MetaParameters, after_encoding, over_tasks, task_loss, with_stages
from metapp.learning.recipe import Adam, OuterLoop
from metapp.learning.task import Batch, Params, Tasks
from metapp.paradigms.paradigm import NO_OUTER_LOOP, Paradigm

TUNED = ("rate", "beta1", "beta2", "eps", "final")  # settings of QuickFT's Adam, as its checkpoints name them


class Overfit(Paradigm):
    """Adam from a random initialisation, until it has converged."""

    name = "overfit"

    @property
    def recipe_steps(self) -> int:
        """Overfit's."""
        return self.recipe.overfit_steps

    def adam(self, phi: MetaParameters) -> Adam:
        """The recipe's, for Overfit."""
        return self.recipe.overfit

    def initialisation(self, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        """Random parameters, but those that the tasks give themselves."""
        return draw_per_task(lambda some, own: self.app.init(own, len(some)), tasks, rng) | self.app.known(tasks)


class General(Paradigm):
    """theta = encode(I): an encoder, trained over all tasks, predicts the parameters in one forward pass; no steps."""

    name = "general"
    needs: tuple[str, ...] = ("general",)

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
        loss = after_encoding(task_loss(app, self.recipe.batch, outer=True), Encoding(app.condition, app.encode))
        outer = over_tasks(loss, count=training.tasks, augment=app.augment if training.augment else None)
        # staged before tasks are augmented: what is not seen need not be made
        return with_stages(outer, app.stage)


class Finetune(General):
    """Adam from General's prediction, for about a tenth of Overfit's steps."""

    name = "finetune"

    @property
    def recipe_steps(self) -> int:
        """Finetune's."""
        return self.recipe.finetune_steps

    def adam(self, phi: MetaParameters) -> Adam:
        """The recipe's, for Finetune."""
        return self.recipe.finetune


class QuickFT(General):
    """As many Adam steps as Meta takes, from General's prediction; the Adam is searched on validation tasks."""

    name = "quickft"
    needs = ("general", "quickft")
    training = NO_OUTER_LOOP

    @property
    def recipe_steps(self) -> int:
        """Meta's."""
        return self.recipe.steps

    @property
    def searched_from(self) -> Adam:
        """The recipe's Adam: a win over a badly tuned baseline is no win."""
        return self.recipe.quickft

    def adam(self, phi: MetaParameters) -> Adam:
        """The Adam that was tuned on this data's validation tasks, else the recipe's."""
        tuned = {key: float(value) for key, value in phi.alpha.items()}
        return Adam(**tuned) if tuned else self.recipe.quickft

    def first_phi(self, general: MetaParameters | None, tasks: Tasks, rng: Generator) -> MetaParameters:
        """General's encoder."""
        assert general is not None
        return general

    def with_adam(self, phi: MetaParameters, adam: Adam) -> MetaParameters:
        """The encoder, and an Adam's settings as alpha: scalars on the CPU."""
        return phi._replace(alpha={key: torch.tensor(getattr(adam, key), dtype=torch.float64) for key in TUNED})


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
