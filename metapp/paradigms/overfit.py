"""Overfit: a random start, Adam until converged; nothing is prepared."""

from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Adam
from metapp.paradigms.paradigm import Job, Paradigm, by_adam


def adam_of(job: Job, prepared: MetaParameters) -> Adam:
    """Return the recipe's."""
    return job.recipe.overfit


OVERFIT = Paradigm(
    name="overfit",
    needs=lambda job: (),
    start=lambda job, prepared, tasks, rng: job.app.init(rng, len(tasks)),
    rule=by_adam(adam_of),
    steps=lambda recipe: recipe.overfit_steps,
    adam=adam_of,
)
