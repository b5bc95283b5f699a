"""Finetune: General's result, then Adam for about a tenth of Overfit's steps."""

from metapp.paradigms import Paradigm
from metapp.paradigms.general import GENERAL, start
from metapp.rules import fixed_adam

FINETUNE = Paradigm(
    name="finetune",
    needs=GENERAL.needs,
    start=start,
    rule=lambda job, prepared, theta, steps: fixed_adam(job.recipe.finetune, theta, steps),
    steps=lambda recipe: recipe.finetune_steps,
)
