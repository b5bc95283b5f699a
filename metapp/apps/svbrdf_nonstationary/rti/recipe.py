"""The recipe of non-stationary svBRDFs from photographs under many lamps: a network that reads light curves."""

from __future__ import annotations

from dataclasses import replace

from metapp.apps.svbrdf_nonstationary.recipes import LEARNED, PHOTO_RECIPES
from metapp.apps.svbrdf_nonstationary.rti.curve_network import CurveNetwork
from metapp.apps.svbrdf_nonstationary.rti.lit_judge import LitJudge
from metapp.apps.svbrdf_nonstationary.rti.lit_sight import LitSight
from metapp.apps.svbrdf_nonstationary.rti.mean_encoder import MeanEncoder
from metapp.apps.svbrdf_nonstationary.rti.rti_app import RtiApp
from metapp.learning.recipe import Adam, AdamSearch, OuterLoop

FINEST_RTI_PX = 4096  # longest side at which a user's photographs are read
SEARCHED = Adam(1e-4, beta1=0.8, beta2=0.9, eps=1e-6, final_rate_share=0.1)
# few candidates, since a validation fits 42 domes of 80 lamps
SEARCH: AdamSearch = (
    [{"rate": factor} for factor in (0.3, 1.0, 3.0)],
    [{"beta1": 0.5, "beta2": 0.9}, {"beta1": 0.9, "beta2": 0.97}],
    [{"final_rate_share": 0.0}, {"final_rate_share": 1.0, "rate": 0.6}],
    [{"rate": 0.7}, {"rate": 1.4}],
)

RTI = replace(
    PHOTO_RECIPES["full"],
    app=RtiApp(CurveNetwork(), LitSight(), LitJudge(), MeanEncoder(), FINEST_RTI_PX),
    steps=15,
    samples=128,
    overfit_steps=1000,
    overfit=Adam(2e-3, final_rate_share=0.0),
    finetune_steps=150,
    finetune=Adam(1e-4, final_rate_share=0.0),
    quickft=SEARCHED,
    general=OuterLoop(
        steps=5000,
        tasks=8,
        rates={"": 2e-3},
        warmup_steps=100,
        final_rate_share=0.0,
        validate_every=250,
        validation_variants=2,
    ),
    meta={
        "meta-encoder": replace(
            LEARNED,
            steps=150,
            tasks=2,
            rates={"": 3e-5, "alpha.": 1e-2},
            initial_adam=SEARCHED,
            validate_every=50,
            guard=None,
        )
    },
    rule="meta-encoder",
    search=SEARCH,
)
