"""Recipes of stationary svBRDFs."""

from __future__ import annotations

from dataclasses import replace

from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.exemplar.recipes import generator, pixels, pyramid
from metapp.apps.svbrdf_stationary.app import SvbrdfStationary
from metapp.learning.recipe import Adam, Recipe, as_published
from metapp.networks.generators import UNet

PRIOR = 0.5  # in fits of 256 texels, of how far these are from General's, which else take the place of diffuse colour


def _with_prior(recipe: Recipe, prior: float) -> Recipe:
    """Return a recipe whose fits have a prior of this weight."""
    app = recipe.app
    assert isinstance(app, SvbrdfStationary)
    return replace(recipe, app=replace(app, prior=prior))


QUICK = generator(
    SvbrdfStationary,
    steps=20,
    outputs=6,
    tasks=3,
    rate=3e-4,
    searched=Adam(3e-3, beta1=0.5, beta2=0.97, final=0.3),
    general=pixels(2500, 6),
)
FULL = _with_prior(pyramid(QUICK, steps=14, searched=Adam(2.9e-3, beta1=0.3, beta2=0.9, final=0.3), tasks=3), PRIOR)
# Fischer & Ritschel 2022, section 4.1.3 and supplement: 20 inner steps, meta-batch 3
TAPS = ("relu1_2", "relu2_2", "relu3_3", "relu4_3")
PUBLISHED = SvbrdfStationary(UNet(32, outputs=6), Octaves(256, 256, TAPS))
PAPER = as_published(QUICK, PUBLISHED, tasks=3, validate_every=50)
# at a side, in texels, whose outer steps take seconds on CPUs
PAPER_64 = replace(PAPER, app=replace(PUBLISHED, octaves=Octaves(64, 64, TAPS)))
RECIPES = {"paper": PAPER, "paper-64": PAPER_64, "quick": QUICK, "full": FULL}
