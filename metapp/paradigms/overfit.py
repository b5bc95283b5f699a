"""Overfit: a random initialisation, Adam until converged; nothing is prepared."""

from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Adam
from metapp.learning.task import Params, Rng, Tasks, drawn
from metapp.paradigms.paradigm import Job, Paradigm, by_adam


def adam_of(job: Job, prepared: MetaParameters) -> Adam:
    """Return the recipe's."""
    return job.recipe.overfit


def initialisation(job: Job, prepared: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
    """Return random parameters, but those that the tasks give themselves."""
    random = drawn(lambda some, own: job.app.init(own, len(some)), tasks, rng)
    return random | job.app.known(tasks)


OVERFIT = Paradigm(
    name="overfit",
    needs=lambda job: (),
    initialisation=initialisation,
    rule=by_adam(adam_of),
    steps=lambda recipe: recipe.overfit_steps,
    adam=adam_of,
)
