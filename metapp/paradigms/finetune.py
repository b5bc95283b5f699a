"""Finetune: General's result, then Adam for about a tenth of Overfit's steps."""

from metapp.paradigms.general import GENERAL, beginning
from metapp.paradigms.paradigm import by_adam

FINETUNE = GENERAL._replace(
    name="finetune",
    initialisation=beginning,
    rule=by_adam(lambda job, prepared: job.recipe.finetune),
    steps=lambda recipe: recipe.finetune_steps,
    adam=lambda job, prepared: job.recipe.finetune,
)
