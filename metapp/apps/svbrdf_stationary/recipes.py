"""The recipes of stationary svBRDFs: sizes, numbers of steps, and rates.

They are made by :mod:`metapp.apps.exemplar.recipes`, which also makes the recipes of textures.
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
from metapp.apps.svbrdf_stationary.app import compose_svbrdf
from metapp.learning.recipe import Adam, paper_recipe
from metapp.networks.generators import Pyramid, UNet

QUICK = generator_recipe(
    compose_svbrdf(UNet(16, outputs=6), QUICK_OCTAVES),
    steps=20,
    tasks=3,
    rate=3e-4,
    searched=Adam(3e-3, beta1=0.5, beta2=0.97, final_rate_share=0.3),
    general=general_training(2500, 6),
)
SEARCHED_ADAM = Adam(2.9e-3, beta1=0.3, beta2=0.9, final_rate_share=0.3)
# a short search: a fit takes seconds, and the error depends little on the Adam
QUILT_SEARCH = (
    [{"rate": 0.5}, {"rate": 2.0}],
    [{"beta1": 0.7, "beta2": 0.97}],
    [{"final_rate_share": 0.0}],
)
# maps of the size that people use: a fifth of the steps sees 64 texels a side, the last two fifths see 256
FULL = replace(
    QUICK,
    steps=14,
    quickft=SEARCHED_ADAM,
    general=general_training(2400, 3, validate_every=400),
    meta={
        "meta-encoder": QUICK.meta["meta-encoder"],
        "meta-axes": replace(QUICK.meta["meta-basis"], initial_adam=SEARCHED_ADAM),
    },
    rule="meta-axes",
    search=QUILT_SEARCH,
    app=compose_svbrdf(
        Pyramid(16, noise=0, outputs=6, quilt=3),
        replace(FULL_OCTAVES, shares=(0.2, 0.6)),
        CANDIDATES,
        expects_gloss=True,
    ),
)
# Fischer & Ritschel 2022, section 4.1.3 and supplement: 20 inner steps, 3 tasks an outer step
TAPS = ("relu1_2", "relu2_2", "relu3_3", "relu4_3")
PAPER = paper_recipe(QUICK, compose_svbrdf(UNet(32, outputs=6), Octaves(256, 256, TAPS)), tasks=3, validate_every=50)
# 64 texels a side, at which an outer step takes seconds on CPUs
PAPER_64 = replace(PAPER, app=compose_svbrdf(UNet(32, outputs=6), Octaves(64, 64, TAPS)))
RECIPES = {"paper": PAPER, "paper-64": PAPER_64, "quick": QUICK, "full": FULL}
