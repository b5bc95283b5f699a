"""The paradigms without a learned rule: a plain Adam from random parameters, or from an encoder's prediction.

Overfit stands alone. General predicts parameters, and Finetune and QuickFT continue its prediction for different
numbers of steps, so that they are subclasses of General.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Generator
from typing_extensions import override

from metapp.learning.adjoint import Loss
from metapp.learning.app import App
from metapp.learning.learn import (
    EncoderPrediction,
    MetaParameters,
    after_encoding,
    over_tasks,
    task_loss,
    with_coarsening,
)
from metapp.learning.random_tensors import Rng, draw_per_task
from metapp.learning.recipe import Adam, OuterLoop
from metapp.learning.task import Batch, Params, Tasks
from metapp.paradigms.paradigm import CheckpointTraining, Paradigm

# fields of `Adam` that QuickFT's checkpoints hold, each as a tensor of the field's name
QUICKFT_ADAM_SETTINGS = ("rate", "beta1", "beta2", "eps", "final_rate_share")


class Overfit(Paradigm):
    """Adam from a random initialisation, until it has converged."""

    name = "overfit"
    steps_field = "overfit_steps"
    takes_long = True

    @override
    def adam(self, phi: MetaParameters) -> Adam:
        return self.recipe.overfit

    @override
    def initialisation(self, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        """Return random parameters; parameters that tasks determine replace random ones."""
        drawn = draw_per_task(lambda tasks, rng: self.app.init(rng, len(tasks)), tasks, rng)
        return drawn | self.app.task_parameters(tasks)


class General(Paradigm):
    """An encoder, trained over all tasks, that predicts the parameters in one forward pass: theta = encode(I)."""

    name = "general"

    @property
    @override
    def trainings(self) -> tuple[CheckpointTraining, ...]:
        return (GeneralTraining(General.of(self.app, self.recipe)),)

    @override
    def initialisation(self, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        """Return the encoder's prediction."""
        return predict_parameters(self.app, phi, tasks, rng)


class Finetune(General):
    """Adam from General's prediction, for about a tenth of Overfit's steps."""

    name = "finetune"
    steps_field = "finetune_steps"
    takes_long = True

    @override
    def adam(self, phi: MetaParameters) -> Adam:
        return self.recipe.finetune

    @override
    def initialisation(self, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        """Return the encoder's prediction; parameters that it does not predict are determined by tasks."""
        return self.app.task_parameters(tasks) | super().initialisation(phi, tasks, rng)


class QuickFT(Finetune):
    """Adam from General's prediction, for as many steps as Meta takes, with settings from a search.

    The search looks for the lowest error of fits of validation tasks. See :class:`AdamSearchTraining`.
    """

    name = "quickft"
    steps_field = "steps"  # as many as Meta takes
    takes_long = False

    @property
    @override
    def trainings(self) -> tuple[CheckpointTraining, ...]:
        """The training of General's encoder, and the search of an Adam for it."""
        return (*super().trainings, AdamSearchTraining(QuickFT.of(self.app, self.recipe)))

    @override
    def adam(self, phi: MetaParameters) -> Adam:
        """Return the Adam that a search found on validation tasks; the recipe's Adam if phi holds none."""
        tuned = {key: float(value) for key, value in phi.alpha.items()}
        return Adam(**tuned) if tuned else self.recipe.quickft


@dataclass(frozen=True)
class GeneralTraining(CheckpointTraining):
    """The training of General's encoder."""

    paradigm: General

    @property
    @override
    def general(self) -> CheckpointTraining:
        return self

    @property
    @override
    def shared_by_observations(self) -> bool:
        """True, as an encoder depends on what fits see only by its input."""
        return True

    @property
    @override
    def outer_loop(self) -> OuterLoop:
        return self.paradigm.recipe.general

    @override
    def first_phi(self, general: MetaParameters | None, tasks: Tasks, rng: Generator) -> MetaParameters:
        """Return an untrained encoder."""
        return MetaParameters(encoder=self.paradigm.app.init_encoder(rng))

    @override
    def template(self, phi: MetaParameters) -> MetaParameters:
        """Return an untrained encoder, whatever phi holds."""
        return MetaParameters(encoder=self.paradigm.app.init_encoder(Generator().manual_seed(0)))

    @override
    def outer_loss(self, phi: MetaParameters) -> Loss:
        """Return the outer loss of the encoder's predictions."""
        app, outer_loop = self.paradigm.app, self.outer_loop
        prediction = EncoderPrediction(app.encoder_input, app.encode)
        loss = after_encoding(task_loss(app, self.paradigm.recipe.samples, outer=True), prediction)
        outer = over_tasks(loss, count=outer_loop.tasks, augment=app.augment if outer_loop.augment else None)
        # tasks are coarsened before they are augmented, so that nothing is augmented in vain
        return with_coarsening(outer, app.coarsen)


@dataclass(frozen=True)
class AdamSearchTraining(CheckpointTraining):
    """The search of QuickFT's Adam, for the encoder of a trained General."""

    paradigm: QuickFT

    @property
    @override
    def general(self) -> CheckpointTraining:
        """The training of the General whose predictions the Adam continues."""
        return self.paradigm.trainings[0]

    @property
    @override
    def begins_at_general(self) -> bool:
        """True, as the Adam descends from General's predictions."""
        return True

    @property
    @override
    def takes_encoder_from_general(self) -> bool:
        """True, as QuickFT's checkpoint holds the settings of an Adam alone."""
        return True

    @property
    @override
    def first_adam(self) -> Adam:
        """The recipe's Adam for QuickFT. It is searched because a win over a badly tuned baseline is no win."""
        return self.paradigm.recipe.quickft

    @override
    def first_phi(self, general: MetaParameters | None, tasks: Tasks, rng: Generator) -> MetaParameters:
        """Return General's encoder."""
        assert general is not None
        return general

    @override
    def template(self, phi: MetaParameters) -> MetaParameters:
        """Return the settings of one Adam, scalars."""
        return self.with_adam(MetaParameters(), self.first_adam)

    @override
    def with_adam(self, phi: MetaParameters, adam: Adam) -> MetaParameters:
        """Return the encoder of phi with an Adam's settings as alpha, scalars on the CPU."""
        return phi._replace(
            alpha={key: torch.tensor(getattr(adam, key), dtype=torch.float64) for key in QUICKFT_ADAM_SETTINGS}
        )


def predict_parameters(app: App, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
    """Predict parameters of tasks by the encoder of phi, encode(I): detached tensors [T, ...]."""
    theta = app.encode(phi.encoder, draw_per_task(app.encoder_input, tasks, rng))
    return {key: value.detach() for key, value in theta.items()}


def encoder_prediction(app: App) -> EncoderPrediction:
    """Return General's prediction as a differentiable function of the encoder.

    Parameters that the encoder does not predict are determined by tasks. See
    :meth:`metapp.learning.app.App.task_parameters`.
    """

    def encoder_input(tasks: Tasks, rng: Generator) -> tuple[Batch, Params]:
        return app.encoder_input(tasks, rng), app.task_parameters(tasks)

    def encode(encoder: Params, encoder_input: tuple[Batch, Params]) -> Params:
        return encoder_input[1] | app.encode(encoder, encoder_input[0])

    return EncoderPrediction(encoder_input, encode)
