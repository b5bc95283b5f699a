"""The recipes of textures: sizes, numbers of steps, and rates.

They are made by :mod:`metapp.apps.exemplar.recipes`, which also makes the recipes of stationary svBRDFs.
"""

from __future__ import annotations

from dataclasses import replace

from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.exemplar.recipes import general_training, generator_recipe, pyramid_recipe
from metapp.apps.texture.app import Texture
from metapp.learning.recipe import Adam, paper_recipe
from metapp.networks.generators import UNet

QUICK = generator_recipe(
    Texture,
    steps=15,
    outputs=3,
    tasks=4,
    rate=1e-4,
    searched=Adam(5e-3, beta1=0.5, beta2=0.99, final_rate_share=0.6),
    general=general_training(4000, 8),
)
FULL = pyramid_recipe(QUICK, steps=10, searched=Adam(6.2e-3, beta1=0.5, beta2=0.97, final_rate_share=0.1), tasks=4)
# Fischer & Ritschel 2022, section 4.1.1 and supplement: 15 inner steps, 5 tasks an outer step
TAPS = ("relu1_2", "relu2_2", "relu3_3", "relu4_3", "relu5_3")
PUBLISHED_APP = Texture(UNet(32), Octaves(192, 256, TAPS))
PAPER = paper_recipe(QUICK, PUBLISHED_APP, validate_every=50)
# 64 texels a side, at which an outer step takes seconds on CPUs
PAPER_64 = replace(PAPER, app=replace(PUBLISHED_APP, octaves=Octaves(64, 64, TAPS)))
RECIPES = {"paper": PAPER, "paper-64": PAPER_64, "quick": QUICK, "full": FULL}
