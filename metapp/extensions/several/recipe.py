"""The recipe of non-stationary svBRDFs from several photos: maps of each texel, begun by photometric stereo."""

from __future__ import annotations

from dataclasses import replace

from metapp.apps.svbrdf_nonstationary.recipes import GENTLE, RECIPES
from metapp.extensions.several.app import SeveralPhotos
from metapp.learning.recipe import Adam, OuterLoop

SEARCHED = Adam(0.03, beta1=0.9, beta2=0.95, eps=2e-3, final=0.1)
SEVERAL = replace(
    RECIPES["photo"]["full"],
    app=SeveralPhotos(),
    steps=30,
    overfit_steps=300,
    overfit=Adam(0.05, beta1=0.9, beta2=0.95, final=0.0),
    finetune_steps=100,
    finetune=replace(SEARCHED, rate=0.02),
    quickft=SEARCHED,
    general=OuterLoop(steps=4200, tasks=40, rates={"": 1.5e-3}, warmup=100, final=0.01, decay=1e-4),
    meta={
        "meta-encoder": replace(
            GENTLE, steps=130, rates={"": 0.0, "alpha.": 3e-2}, first=SEARCHED, final=0.02, warmup=5, validate_every=20
        )
    },
)
