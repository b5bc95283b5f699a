"""How stationary svBRDFs are fitted and what their rules learn."""

from __future__ import annotations

from dataclasses import replace

from metapp.learning.recipe import AS_PUBLISHED, Adam, MetaTraining, OuterLoop, Recipe
from metapp.networks.exemplar import ExemplarSetup, full_recipe
from metapp.networks.layers import UNet

PRIOR = 0.5  # in fits of 256 texels, of how far these are from General's, which else take the place of diffuse colour
LEARNED = MetaTraining(
    steps=300,
    tasks=3,
    rates={"": 1e-3, "alpha.": 1e-2},
    first=Adam(3.7e-3, beta1=0.7, beta2=0.99, final=0.3),
    warmup=20,
    final=0.01,
    order=1,
    clip=1e-2,
    validate_every=100,
)
ENCODED = replace(LEARNED, initialisation="encoder", rates={"": 3e-4, "alpha.": 3e-3})
TUNED = MetaTraining(
    steps=0,
    tasks=0,
    rates={"": 0.0},
    first=Adam(3e-3, beta1=0.5, beta2=0.97, final=0.3),
    tuned=True,
    initialisation="encoder",
)
QUICK = Recipe(
    steps=20,
    batch=1,
    overfit_steps=1000,
    overfit=Adam(5e-3, beta2=0.99, final=0.0),
    finetune_steps=100,
    finetune=Adam(5e-3, beta2=0.99, final=0.0),
    quickft=Adam(3.7e-3, beta1=0.7, beta2=0.99, final=0.3),
    general=OuterLoop(steps=2500, tasks=6, rates={"": 3e-3, "encoder.mlp": 1e-3}, warmup=50, final=0.0),
    meta={
        "meta-sgd": replace(LEARNED, first=Adam(0.1)),
        "meta-adam-tied": LEARNED,
        "meta-encoder": ENCODED,
        "meta-mean": TUNED,
        "meta-basis": TUNED,
    },
    rule="meta-basis",
    setup=ExemplarSetup(64, 64, UNet(16, outputs=6), "vgg16", ("relu1_1", "relu2_1", "relu3_1")),
)
FULL = full_recipe(QUICK, found=Adam(2.9e-3, beta1=0.3, beta2=0.9, final=0.3), tasks=3)
FULL = replace(FULL, setup=replace(FULL.setup, prior=PRIOR))

# Fischer & Ritschel 2022, section 4.1.3 and supplement: 20 inner steps, first-order MAML with Meta-SGD, meta-batch 3,
# a random initialisation
PAPER = replace(
    QUICK,
    overfit_steps=10_000,
    finetune_steps=1_000,
    meta={"meta-sgd": replace(AS_PUBLISHED, tasks=3)},
    rule="meta-sgd",
    setup=ExemplarSetup(256, 256, UNet(32, outputs=6), "vgg16", ("relu1_2", "relu2_2", "relu3_3", "relu4_3")),
)

RECIPES = {"": {"paper": PAPER, "quick": QUICK, "full": FULL}}
