"""The paradigms without a learned rule: a plain Adam from random parameters, or from an encoder's prediction."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Generator

from metapp.learning.adjoint import Loss
from metapp.learning.app import App
from metapp.learning.learn import EncoderPrediction, MetaParameters, after_encoding, over_tasks, task_loss, with_stages
from metapp.learning.random_tensors import Rng, draw_per_task
from metapp.learning.recipe import Adam, OuterLoop, Recipe
from metapp.learning.task import Batch, Params, Tasks
from metapp.paradigms.paradigm import Paradigm, Preparation

QUICKFT_ADAM_SETTINGS = (
    "rate",
    "beta1",
    "beta2",
    "eps",
    "final",
)  # settings of QuickFT's Adam, as its checkpoints name them


class Overfit(Paradigm):
    """Adam from a random initialisation, until it has converged."""

    name = "overfit"
    takes_long = True

    @staticmethod
    def _usual_steps(recipe: Recipe) -> int:
        """Return Overfit's number of gradient steps."""
        return recipe.overfit_steps

    def adam(self, phi: MetaParameters) -> Adam:
        """Return the recipe's Adam for Overfit."""
        return self.recipe.overfit

    def initialisation(self, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        """Return random parameters, but those that the tasks give themselves."""
        drawn = draw_per_task(lambda some, own: self.app.init(own, len(some)), tasks, rng)
        return drawn | self.app.task_parameters(tasks)


class General(Paradigm):
    """theta = encode(I): an encoder, trained over all tasks, predicts the parameters in one forward pass; no steps."""

    name = "general"

    @staticmethod
    def _usual_steps(recipe: Recipe) -> int:
        """Return 0: General only predicts."""
        return 0

    @property
    def preparations(self) -> tuple[Preparation, ...]:
        """The training of General's encoder."""
        return (GeneralPreparation(General.of(self.app, self.recipe)),)

    def initialisation(self, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        """Return the encoder's prediction."""
        return predict_parameters(self.app, phi, tasks, rng)


class Finetune(General):
    """Adam from General's prediction, for about a tenth of Overfit's steps."""

    name = "finetune"
    takes_long = True

    @staticmethod
    def _usual_steps(recipe: Recipe) -> int:
        """Return Finetune's number of gradient steps."""
        return recipe.finetune_steps

    def adam(self, phi: MetaParameters) -> Adam:
        """Return the recipe's Adam for Finetune."""
        return self.recipe.finetune

    def initialisation(self, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        """Return the encoder's prediction, with the parameters that tasks give themselves."""
        return self.app.task_parameters(tasks) | super().initialisation(phi, tasks, rng)


class QuickFT(Finetune):
    """As many Adam steps as Meta takes, from General's prediction; the Adam is searched on validation tasks."""

    name = "quickft"
    takes_long = False

    @staticmethod
    def _usual_steps(recipe: Recipe) -> int:
        """Return the number of gradient steps that Meta takes, too."""
        return recipe.steps

    @property
    def preparations(self) -> tuple[Preparation, ...]:
        """The training of General's encoder, and the search of an Adam for it."""
        return (*super().preparations, QuickFTPreparation(QuickFT.of(self.app, self.recipe)))

    def adam(self, phi: MetaParameters) -> Adam:
        """Return the Adam that was tuned on this data's validation tasks, else the recipe's."""
        tuned = {key: float(value) for key, value in phi.alpha.items()}
        return Adam(**tuned) if tuned else self.recipe.quickft


@dataclass(frozen=True)
class GeneralPreparation(Preparation):
    """The training of General's encoder."""

    paradigm: General

    @property
    def general(self) -> Preparation:
        """This preparation itself."""
        return self

    @property
    def shared_by_protocols(self) -> bool:
        """True: an encoder learns nothing of the protocol but by what it reads."""
        return True

    @property
    def outer_loop(self) -> OuterLoop:
        """The encoder's training."""
        return self.paradigm.recipe.general

    def first_phi(self, general: MetaParameters | None, tasks: Tasks, rng: Generator) -> MetaParameters:
        """Return an untrained encoder."""
        return MetaParameters(encoder=self.paradigm.app.init_encoder(rng))

    def template(self, phi: MetaParameters) -> MetaParameters:
        """Return an untrained encoder, whatever phi holds."""
        return MetaParameters(encoder=self.paradigm.app.init_encoder(Generator().manual_seed(0)))

    def outer_loss(self, phi: MetaParameters) -> Loss:
        """Return the loss of the encoder's predictions."""
        app, training = self.paradigm.app, self.outer_loop
        encoded = EncoderPrediction(app.condition, app.encode)
        loss = after_encoding(task_loss(app, self.paradigm.recipe.batch, outer=True), encoded)
        outer = over_tasks(loss, count=training.tasks, augment=app.augment if training.augment else None)
        # staged before tasks are augmented: what is not seen need not be made
        return with_stages(outer, app.stage)


@dataclass(frozen=True)
class QuickFTPreparation(Preparation):
    """The search of QuickFT's Adam for the encoder of a trained General."""

    paradigm: QuickFT

    @property
    def general(self) -> Preparation:
        """The preparation of the General that the Adam is tuned for."""
        return self.paradigm.preparations[0]

    @property
    def begins_at_general(self) -> bool:
        """True: the Adam descends from General's predictions."""
        return True

    @property
    def takes_encoder_from_general(self) -> bool:
        """True: General's file holds the encoder."""
        return True

    @property
    def first_adam(self) -> Adam:
        """The recipe's Adam: a win over a badly tuned baseline is no win."""
        return self.paradigm.recipe.quickft

    def first_phi(self, general: MetaParameters | None, tasks: Tasks, rng: Generator) -> MetaParameters:
        """Return General's encoder."""
        assert general is not None
        return general

    def template(self, phi: MetaParameters) -> MetaParameters:
        """Return the settings of one Adam, scalars."""
        return self.with_adam(MetaParameters(), self.first_adam)

    def with_adam(self, phi: MetaParameters, adam: Adam) -> MetaParameters:
        """Return the encoder, and an Adam's settings as alpha: scalars on the CPU."""
        return phi._replace(
            alpha={key: torch.tensor(getattr(adam, key), dtype=torch.float64) for key in QUICKFT_ADAM_SETTINGS}
        )


def predict_parameters(app: App, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
    """encode(I), the parameters that an encoder predicts of tasks, [T, ...]."""
    encoded = app.encode(phi.encoder, draw_per_task(app.condition, tasks, rng))
    return {key: value.detach() for key, value in encoded.items()}


def encoder_prediction(app: App) -> EncoderPrediction:
    """General's prediction, with the parameters that tasks give themselves, as a function of tasks."""

    def condition(tasks: Tasks, rng: Generator) -> tuple[Batch, Params]:
        return app.condition(tasks, rng), app.task_parameters(tasks)

    def encode(encoder: Params, condition: tuple[Batch, Params]) -> Params:
        return condition[1] | app.encode(encoder, condition[0])

    return EncoderPrediction(condition, encode)
