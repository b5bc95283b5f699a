"""Finetune: General's result, then Adam for about a tenth of Overfit's steps."""

from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Adam
from metapp.paradigms.general import GENERAL, beginning
from metapp.paradigms.paradigm import Job, by_adam


def adam_of(job: Job, prepared: MetaParameters) -> Adam:
    """Return the recipe's."""
    return job.recipe.finetune


FINETUNE = GENERAL._replace(
    name="finetune",
    initialisation=beginning,
    rule=by_adam(adam_of),
    steps=lambda recipe: recipe.finetune_steps,
    adam=adam_of,
)
