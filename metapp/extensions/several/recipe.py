"""The recipe of non-stationary svBRDFs from several photos: maps of each texel, begun by photometric stereo."""

from __future__ import annotations

from dataclasses import replace

from metapp.apps.svbrdf_nonstationary.recipes import GENTLE, RECIPES
from metapp.extensions.several.app import SeveralPhotos
from metapp.learning.recipe import Adam, OuterLoop

# On 8 validation materials a rate of 0.02 leaves 0.706 of a flat map's angles, 0.03 0.705, 0.04 0.709.
CHOSEN = Adam(0.03, beta1=0.9, beta2=0.95, eps=2e-3, final=0.1)
SEVERAL = replace(
    RECIPES["photo"]["full"],
    app=SeveralPhotos(),
    steps=30,
    overfit_steps=300,
    overfit=Adam(0.05, beta1=0.9, beta2=0.95, final=0.0),
    finetune_steps=100,
    finetune=replace(CHOSEN, rate=0.02),
    quickft=CHOSEN,
    general=OuterLoop(steps=4200, tasks=8, rates={"": 1.5e-3}, warmup=100, final=0.01),
    meta={
        "meta-encoder": replace(
            GENTLE,
            steps=130,
            tasks=2,
            rates={"": 0.0, "alpha.": 3e-2},
            first=CHOSEN,
            final=0.02,
            warmup=5,
            validate_every=20,
        )
    },
)
