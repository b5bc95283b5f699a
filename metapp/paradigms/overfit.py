"""Overfit: a random initialisation, Adam until converged; nothing is prepared."""

from metapp.learning.draws import Rng, draw_per_task
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Adam
from metapp.learning.task import Params, Tasks
from metapp.paradigms.paradigm import Paradigm


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
