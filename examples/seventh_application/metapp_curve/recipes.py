"""Recipes of curves: how long and by which rates curves are fitted, and what rules learn."""

from __future__ import annotations

from metapp.learning.recipe import Adam, MetaTraining, OuterLoop, Recipe, paper_recipe
from metapp_curve.app import Curve

QUICK = Recipe(
    steps=10,
    samples=8,
    overfit_steps=500,
    overfit=Adam(1e-2, final_rate_share=0.01),
    finetune_steps=100,
    finetune=Adam(3e-3, final_rate_share=0.01),
    quickft=Adam(1e-2),
    general=OuterLoop(steps=500, tasks=4, rates={"": 1e-3}, validate_every=100),
    meta={"meta-adam": MetaTraining(steps=200, tasks=4, rates={"": 1e-3, "alpha.": 1e-2}, order=2, validate_every=50)},
    rule="meta-adam",
    app=Curve(),
)
PAPER = paper_recipe(QUICK, Curve())

RECIPES = {"paper": PAPER, "quick": QUICK}
