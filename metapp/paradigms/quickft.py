"""QuickFT: General's result, then Adam at a raised rate for Meta's number of steps."""

from __future__ import annotations

import torch
from torch import Generator

from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Adam, OuterLoop
from metapp.learning.task import Tasks
from metapp.paradigms.general import General
from metapp.paradigms.paradigm import NO_OUTER_LOOP

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

    def adam(self, phi: MetaParameters) -> Adam:
        """The Adam that was tuned on this data's validation tasks, else the recipe's."""
        tuned = {key: float(value) for key, value in phi.alpha.items()}
        return Adam(**tuned) if tuned else self.recipe.quickft

    @property
    def training(self) -> OuterLoop:
        """No outer loop."""
        return NO_OUTER_LOOP

    @property
    def searched_from(self) -> Adam:
        """The recipe's Adam: a win over a badly tuned baseline is no win."""
        return self.recipe.quickft

    def first_phi(self, general: MetaParameters | None, tasks: Tasks, rng: Generator) -> MetaParameters:
        """General's encoder."""
        assert general is not None
        return general

    def with_adam(self, phi: MetaParameters, adam: Adam) -> MetaParameters:
        """The encoder, and an Adam's settings as alpha: scalars on the CPU."""
        return phi._replace(alpha={key: torch.tensor(getattr(adam, key), dtype=torch.float64) for key in TUNED})
