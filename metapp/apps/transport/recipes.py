"""The recipes of the application transport: networks, sizes and rates of training, each with its reason.

Fits of `full` are fits of `quick`: only the pictures by which they are judged are larger.
"""

from __future__ import annotations

from dataclasses import replace

from metapp.apps.transport.app import Transport
from metapp.apps.transport.flow import Flow
from metapp.apps.transport.path_fits import FlowDensity
from metapp.learning.recipe import Adam, MetaTraining, OuterLoop, Recipe, long_paper_recipe, paper_recipe

# exact second order, from General's encoder, which goes on learning through the steps
LEARNED = MetaTraining(
    steps=100,
    tasks=3,
    rates={"": 3e-4, "alpha.": 2e-2, "alpha.within.": 3e-3},
    initial_adam=Adam(2e-3, beta1=0.5, beta2=0.8, eps=1e-6, final_rate_share=0.3),
    warmup_steps=10,
    final_rate_share=0.05,
    order=2,
    clip=1.0,
    validate_every=20,
    initialisation="encoder",
)
QUICK = Recipe(
    steps=8,
    samples=4096,
    overfit_steps=400,
    overfit=Adam(5e-3, final_rate_share=0.0),
    finetune_steps=40,
    finetune=Adam(2e-3, final_rate_share=0.0),
    quickft=Adam(2e-3, beta1=0.5, beta2=0.8, eps=1e-6, final_rate_share=0.3),
    general=OuterLoop(
        steps=1200,
        tasks=8,
        rates={"": 2e-3},
        warmup_steps=50,
        final_rate_share=0.0,
        weight_decay=1e-4,
        validate_every=100,
    ),
    meta={"meta-encoder": LEARNED},
    rule="meta-encoder",
    app=Transport(FlowDensity(Flow())),
)
# the fits of `quick`, judged by pictures of the size that people render
FULL = replace(QUICK, app=Transport(FlowDensity(Flow()), picture=256))
# Fischer & Ritschel 2022, section 4.1.6: 8 inner steps of 10,000 of 288,000 samples
PAPER = replace(paper_recipe(QUICK, Transport(FlowDensity(Flow(hidden=64, bins=16)))), samples=10_000)
RECIPES = {"paper": PAPER, "paper-long": long_paper_recipe(PAPER), "quick": QUICK, "full": FULL}
