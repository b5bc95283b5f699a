"""Recipes of applications that generate pictures from noise: at 64 texels by a U-Net.

Textures and stationary svBRDFs make their recipes by these functions, and pass what differs between them.
"""

from __future__ import annotations

from dataclasses import replace

from metapp.apps.exemplar.octaves import Octaves
from metapp.learning.app import App
from metapp.learning.recipe import Adam, MetaTraining, OuterLoop, Recipe

GENERAL_RATES = {
    "": 3e-3,
    "encoder.mlp": 1e-3,
}  # learning rates of General's training, by the beginning of parameters' names


CANDIDATES = 12  # quilts of which a fit begins with the best one
QUICK_OCTAVES = Octaves(64, 64, ("relu1_1", "relu2_1", "relu3_1"))
FULL_OCTAVES = Octaves(256, 256, ("relu1_1", "relu2_1", "relu3_1", "relu4_1"), count=3)


def generator_recipe(app: App, *, steps: int, tasks: int, rate: float, searched: Adam, general: OuterLoop) -> Recipe:
    """Return the recipe of pictures of QUICK_OCTAVES that a U-Net generates from noise.

    Args:
        app: the application.
        steps: the number of gradient steps of a fit.
        tasks: the number of tasks of each outer step of a rule's training.
        rate: the learning rate of General's parameters where a rule trains these, too.
        searched: the Adam that the search for the rule "meta-basis" begins with.
        general: how General is trained.
    """
    gradient_adam = Adam(3.7e-3, beta1=0.7, beta2=0.99, final_rate_share=0.3)
    learned_rule = MetaTraining(
        steps=300,
        tasks=tasks,
        rates={"": 1e-3, "alpha.": 1e-2},
        initial_adam=gradient_adam,
        warmup_steps=20,
        final_rate_share=0.01,
        order=1,
        clip=1e-2,
        validate_every=100,
    )
    searched_rule = MetaTraining(
        steps=0, tasks=0, rates={"": 0.0}, initial_adam=searched, searches_adam=True, initialisation="encoder"
    )
    return Recipe(
        steps=steps,
        samples=1,
        overfit_steps=1000,
        overfit=Adam(5e-3, beta2=0.99, final_rate_share=0.0),
        finetune_steps=100,
        finetune=Adam(5e-3, beta2=0.99, final_rate_share=0.0),
        quickft=gradient_adam,
        general=general,
        meta={
            "meta-sgd": replace(learned_rule, initial_adam=Adam(0.1)),
            "meta-encoder": replace(learned_rule, initialisation="encoder", rates={"": rate, "alpha.": 3e-3}),
            "meta-basis": searched_rule,
        },
        rule="meta-basis",
        app=app,
    )


def general_training(steps: int, tasks: int, validate_every: int = 250) -> OuterLoop:
    """Return how General is trained: its encoder and a generator of pictures.

    Args:
        steps: the number of outer steps.
        tasks: the number of tasks of an outer step.
        validate_every: the number of outer steps between validations.
    """
    return OuterLoop(
        steps=steps,
        tasks=tasks,
        rates=GENERAL_RATES,
        warmup_steps=50,
        final_rate_share=0.0,
        validate_every=validate_every,
    )
