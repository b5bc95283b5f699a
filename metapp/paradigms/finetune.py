"""Finetune: General's result, then Adam for about a tenth of Overfit's steps."""

from metapp.learning.rules import fixed_adam
from metapp.paradigms.general import GENERAL, start
from metapp.paradigms.paradigm import Paradigm

FINETUNE = Paradigm(
    name="finetune",
    needs=GENERAL.needs,
    start=start,
    rule=lambda job, prepared, theta, steps: fixed_adam(job.recipe.finetune, theta, steps),
    steps=lambda recipe: recipe.finetune_steps,
    prepare=GENERAL.prepare,
    adam=lambda job, prepared: job.recipe.finetune,
)
