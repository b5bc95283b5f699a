"""Overfit: a random start, Adam until converged; nothing is prepared."""

from metapp.learning.rules import fixed_adam
from metapp.paradigms.paradigm import Paradigm

OVERFIT = Paradigm(
    name="overfit",
    needs=lambda job: (),
    start=lambda job, prepared, tasks, rng: job.app.init(rng, len(tasks)),
    rule=lambda job, prepared, theta, steps: fixed_adam(job.recipe.overfit, theta, steps),
    steps=lambda recipe: recipe.overfit_steps,
    adam=lambda job, prepared: job.recipe.overfit,
)
