"""Recipes of networks that generate pictures from noise."""

from __future__ import annotations

from dataclasses import replace

from metapp.apps.exemplar.app import ExemplarApp
from metapp.apps.exemplar.octaves import Octaves
from metapp.learning.recipe import Adam, MetaTraining, OuterLoop, Recipe
from metapp.networks.generators import Pyramid, UNet

GENERAL_RATES = {"": 3e-3, "encoder.mlp": 1e-3}  # General's rates where it learns a generator of pictures


def generator_recipe(
    app: type[ExemplarApp], *, steps: int, outputs: int, tasks: int, rate: float, searched: Adam, general: OuterLoop
) -> Recipe:
    """The recipe of pictures of 64 texels that are generated from noise.

    Args:
        app: the application.
        steps: gradient steps of a fit.
        outputs: channels of a picture.
        tasks: of each outer step of a rule.
        rate: of General's encoder if rules train it.
        searched: the first Adam of the search for that of rules.
        general: how General's encoder is trained.
    """
    first = Adam(3.7e-3, beta1=0.7, beta2=0.99, final=0.3)
    learned = MetaTraining(
        steps=300,
        tasks=tasks,
        rates={"": 1e-3, "alpha.": 1e-2},
        first=first,
        warmup=20,
        final=0.01,
        order=1,
        clip=1e-2,
        validate_every=100,
    )
    tuned = MetaTraining(steps=0, tasks=0, rates={"": 0.0}, first=searched, tuned=True, initialisation="encoder")
    return Recipe(
        steps=steps,
        batch=1,
        overfit_steps=1000,
        overfit=Adam(5e-3, beta2=0.99, final=0.0),
        finetune_steps=100,
        finetune=Adam(5e-3, beta2=0.99, final=0.0),
        quickft=first,
        general=general,
        meta={
            "meta-sgd": replace(learned, first=Adam(0.1)),
            "meta-encoder": replace(learned, initialisation="encoder", rates={"": rate, "alpha.": 3e-3}),
            "meta-basis": tuned,
        },
        rule="meta-basis",
        app=app(UNet(16, outputs=outputs), Octaves(64, 64, ("relu1_1", "relu2_1", "relu3_1"))),
    )


def general_training(steps: int, tasks: int, validate_every: int = 250) -> OuterLoop:
    """The training of General's encoder beside a generator of pictures."""
    return OuterLoop(steps=steps, tasks=tasks, rates=GENERAL_RATES, warmup=50, final=0.0, validate_every=validate_every)


def pyramid_recipe(quick: Recipe, *, steps: int, searched: Adam, tasks: int) -> Recipe:
    """The recipe of pictures of the size that people use, 256 texels, from coarse to fine.

    A fifth of the steps are at 64 texels, the last two fifths at 256; the network reads a layout of the exemplar.

    Args:
        quick: all else.
        steps: gradient steps of a fit.
        searched: the first Adam of searches.
        tasks: of each outer step of General.
    """
    app, tuned = quick.app, replace(quick.meta["meta-basis"], first=searched)
    assert isinstance(app, ExemplarApp)
    taps = ("relu1_1", "relu2_1", "relu3_1", "relu4_1")
    network = Pyramid(16, outputs=app.network.outputs, layout=3)
    octaves = Octaves(256, 256, taps, count=3, shares=(0.2, 0.6))
    return replace(
        quick,
        steps=steps,
        quickft=searched,
        general=general_training(2400, tasks, validate_every=400),
        meta={"meta-encoder": quick.meta["meta-encoder"], "meta-axes": tuned},
        rule="meta-axes",
        app=replace(app, network=network, octaves=octaves),
    )
