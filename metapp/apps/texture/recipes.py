"""How textures are fitted and what their rules learn."""

from __future__ import annotations

from dataclasses import replace

from metapp.learning.recipe import AS_PUBLISHED, Adam, MetaTraining, OuterLoop, Recipe
from metapp.networks.exemplar import ExemplarSetup, full_recipe
from metapp.networks.layers import UNet

LEARNED = MetaTraining(
    steps=300,
    tasks=4,
    rates={"": 1e-3, "alpha.": 1e-2},
    first=Adam(3.7e-3, beta1=0.7, beta2=0.99, final=0.3),
    warmup=20,
    final=0.01,
    order=1,
    clip=1e-2,
    validate_every=100,
)
ENCODED = replace(LEARNED, initialisation="encoder", rates={"": 1e-4, "alpha.": 3e-3})
TUNED = MetaTraining(
    steps=0,
    tasks=0,
    rates={"": 0.0},
    first=Adam(5e-3, beta1=0.5, beta2=0.99, final=0.6),
    tuned=True,
    initialisation="encoder",
)
QUICK = Recipe(
    steps=15,
    batch=1,
    overfit_steps=1000,
    overfit=Adam(5e-3, beta2=0.99, final=0.0),
    finetune_steps=100,
    finetune=Adam(5e-3, beta2=0.99, final=0.0),
    quickft=Adam(3.7e-3, beta1=0.7, beta2=0.99, final=0.3),
    general=OuterLoop(steps=4000, tasks=8, rates={"": 3e-3, "encoder.mlp": 1e-3}, warmup=50, final=0.0),
    meta={
        "meta-sgd": replace(LEARNED, first=Adam(0.1)),
        "meta-adam-tied": LEARNED,
        "meta-encoder": ENCODED,
        "meta-mean": TUNED,
        "meta-basis": TUNED,
    },
    rule="meta-basis",
    setup=ExemplarSetup(64, 64, UNet(16), "vgg16", ("relu1_1", "relu2_1", "relu3_1")),
)
FULL = full_recipe(QUICK, found=Adam(4.4e-3, beta1=0.5, beta2=0.97, final=0.1), tasks=4)

# Fischer & Ritschel 2022, section 4.1.1 and supplement: 15 inner steps, first-order MAML with Meta-SGD, meta-batch 5,
# a random initialisation
PAPER = replace(
    QUICK,
    overfit_steps=10_000,
    finetune_steps=1_000,
    meta={"meta-sgd": AS_PUBLISHED},
    rule="meta-sgd",
    setup=ExemplarSetup(192, 256, UNet(32), "vgg16", ("relu1_2", "relu2_2", "relu3_3", "relu4_3", "relu5_3")),
)
# the authors' features
VGG19 = replace(
    PAPER,
    setup=replace(PAPER.setup, features="vgg19", taps=("relu1_2", "relu2_2", "relu3_4", "relu4_4", "relu5_4")),
)

RECIPES = {"": {"paper": PAPER, "paper-vgg19": VGG19, "quick": QUICK, "full": FULL}}
