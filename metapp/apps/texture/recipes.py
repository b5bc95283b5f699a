"""The recipes of textures: sizes, numbers of steps, and rates.

They are made by :mod:`metapp.apps.exemplar.recipes`, which also makes the recipes of stationary svBRDFs.
"""

from __future__ import annotations

from dataclasses import replace

from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.exemplar.recipes import (
    CANDIDATES,
    FULL_OCTAVES,
    QUICK_OCTAVES,
    general_training,
    generator_recipe,
)
from metapp.apps.texture.app import compose_texture
from metapp.learning.recipe import Adam, MetaTraining, OuterLoop, paper_recipe
from metapp.networks.generators import UNet
from metapp.networks.quilted import LightGrid

QUICK = generator_recipe(
    compose_texture(UNet(16), QUICK_OCTAVES),
    steps=15,
    tasks=4,
    rate=1e-4,
    searched=Adam(5e-3, beta1=0.5, beta2=0.99, final_rate_share=0.6),
    general=general_training(4000, 8),
)
# 10 steps lower the error of the best of 12 quilts; the network is so small that all paradigms take the same rates
QUILT_ADAM = Adam(0.1, beta1=0.7, beta2=0.97, final_rate_share=0.1)
# the error hardly depends on the Adam: 2 % between rates of 0.05 and 0.4
QUILT_SEARCH = (
    [{"rate": 0.5}, {"rate": 2.0}],
    [{"beta1": 0.5, "beta2": 0.9}, {"beta1": 0.9, "beta2": 0.99}],
    [{"final_rate_share": 0.0}, {"final_rate_share": 0.3}],
)
FULL = replace(
    QUICK,
    steps=10,
    overfit_steps=200,
    overfit=replace(QUILT_ADAM, final_rate_share=0.0),
    finetune_steps=50,
    finetune=replace(QUILT_ADAM, final_rate_share=0.0),
    quickft=QUILT_ADAM,
    general=OuterLoop(steps=600, tasks=4, rates={"": 3e-3}, warmup_steps=20, final_rate_share=0.0, validate_every=100),
    meta={
        "meta-encoder": MetaTraining(
            steps=60,
            tasks=2,
            rates={"": 1e-4, "alpha.": 3e-2},
            initial_adam=QUILT_ADAM,
            warmup_steps=10,
            final_rate_share=0.01,
            order=1,
            clip=1e-1,
            validate_every=20,
            searches_adam=True,
            initialisation="encoder",
        )
    },
    rule="meta-encoder",
    search=QUILT_SEARCH,
    app=compose_texture(LightGrid(), FULL_OCTAVES, CANDIDATES),
)
# Fischer & Ritschel 2022, section 4.1.1 and supplement: 15 inner steps, 5 tasks an outer step
TAPS = ("relu1_2", "relu2_2", "relu3_3", "relu4_3", "relu5_3")
PAPER = paper_recipe(QUICK, compose_texture(UNet(32), Octaves(192, 256, TAPS)), validate_every=50)
# 64 texels a side, at which an outer step takes seconds on CPUs
PAPER_64 = replace(PAPER, app=compose_texture(UNet(32), Octaves(64, 64, TAPS)))
RECIPES = {"paper": PAPER, "paper-64": PAPER_64, "quick": QUICK, "full": FULL}
