"""QuickFT: General's result, then Adam at a raised rate for Meta's number of steps."""

from __future__ import annotations

from collections.abc import Iterator

import torch

from metapp.learning.learn import MetaParameters
from metapp.learning.progress import TrainState
from metapp.learning.recipe import Adam, OuterLoop
from metapp.learning.task import Params
from metapp.paradigms.general import General
from metapp.paradigms.paradigm import TrainingData
from metapp.paradigms.tuning import search

TUNED = ("rate", "beta1", "beta2", "eps", "final")


class QuickFT(General):
    """As many Adam steps as Meta takes, from General's prediction; the Adam is searched on validation tasks."""

    name = "quickft"

    @property
    def needs(self) -> tuple[str, ...]:
        """The encoder, and the Adam that was searched for it."""
        return ("general", "quickft")

    @property
    def recipe_steps(self) -> int:
        """Meta's."""
        return self.recipe.steps

    @property
    def training(self) -> OuterLoop | None:
        """None: there is only a search."""
        return None

    def adam(self, phi: MetaParameters) -> Adam:
        """The Adam that was tuned on this data's validation tasks, else the recipe's."""
        tuned = {key: float(value) for key, value in phi.alpha.items()}
        return Adam(**tuned) if tuned else self.recipe.quickft

    def prepare(self, data: TrainingData) -> Iterator[TrainState]:
        """Search the Adam on validation tasks: a win over a badly tuned baseline is no win.

        The result has Adam's settings as alpha, scalars on the CPU, beside the encoder that they were tuned for.
        """
        encoder = data.encoder
        assert encoder is not None
        return search(self, self.recipe.quickft, lambda adam: encoder._replace(alpha=to_alpha(adam)), data)


def to_alpha(settings: Adam) -> Params:
    """Adam's settings as a checkpoint of QuickFT stores them, scalars."""
    return {key: torch.tensor(getattr(settings, key), dtype=torch.float64) for key in TUNED}
