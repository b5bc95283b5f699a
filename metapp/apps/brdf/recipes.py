"""The recipes of the application brdf: networks, sizes and rates of training, each with its reason.

The recipe `few`, whose fits have a network of another kind, is in `metapp.apps.brdf.few`.
"""

from __future__ import annotations

from dataclasses import replace

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.feature_network import Featured
from metapp.apps.brdf.nbrdf_network import NBRDF_NETWORK, Nbrdf
from metapp.learning.recipe import Adam, Guard, MetaTraining, OuterLoop, Recipe, long_paper_recipe, paper_recipe

# meta-gradients are heavy-tailed, so that the clip gives the gradients of all tasks about the same norm
LEARNED = MetaTraining(
    steps=20_000,
    tasks=4,
    rates={"": 1e-3, "alpha.": 1e-2, "alpha.left": 1e-3, "alpha.right": 1e-3},
    warmup_steps=200,
    final_rate_share=0.01,
    order=2,
    clip=4e-3,
)
# a training with another network, whose features all materials share: each material is a linear combination of them
RIDGE_TRAINING = MetaTraining(
    steps=10_000,
    tasks=4,
    rates={"": 2e-3, "alpha.": 1e-2},
    warmup_steps=200,
    final_rate_share=0.01,
    order=2,
    clip=1e-2,
    validate_every=500,
    validation_variants=4,
    initialisation="untrained",
    app=Brdf(Featured()),
)
# a fit is doubtful if its final over its initial loss is above twice the largest such ratio of a validation material
GUARD = Guard(Adam(1e-2, beta1=0.5, beta2=0.9, final_rate_share=0.1), max_loss_share=0.13)

QUICK = Recipe(
    steps=10,
    samples=512,
    overfit_steps=20_000,
    overfit=Adam(1e-2, final_rate_share=0.0),
    finetune_steps=2_000,
    finetune=Adam(4e-3, final_rate_share=0.0),
    quickft=Adam(5e-3, final_rate_share=0.1),
    general=OuterLoop(
        steps=12_000, tasks=8, rates={"": 1e-3}, warmup_steps=200, final_rate_share=0.0, validate_every=500
    ),
    meta={
        # ten signed gradients from one initialisation for all materials do not reach far enough
        "meta-sgd": replace(
            LEARNED,
            steps=10_000,
            initial_adam=Adam(0.1),
            rates={"": 3e-3, "encoder.": 3e-4},
            initialisation="encoder",
            augment=False,
        ),
        "meta-curvature": replace(LEARNED, guard=GUARD),
        "ridge": RIDGE_TRAINING,
    },
    rule="meta-curvature",
    app=Brdf(NBRDF_NETWORK),
)

# where paradigms need not fit the same network, the rule that is best on validation tasks
FULL = replace(QUICK, rule="ridge")
# for materials whose reflectance depends on phi_h, too, which takes more features; one network for all paradigms
ANISOTROPIC_APP = Brdf(Featured(features=96, code=16, anisotropic=True))
ANISOTROPIC = replace(
    FULL,
    meta={"ridge": replace(RIDGE_TRAINING, steps=4_000, warmup_steps=50, validate_every=100, app=ANISOTROPIC_APP)},
    app=ANISOTROPIC_APP,
)

# Fischer & Ritschel 2022, section 4.1.2: 10 inner steps of 512 samples. First weights and the rate of Overfit are those
# of Sztrajman et al. 2021; metapp/checkpoints/brdf/README.md has the reasons.
PAPER = replace(
    paper_recipe(replace(QUICK, quickft=Adam(5e-3)), Brdf(Nbrdf(bound=0.05)), tasks=1, order=2, augment=False),
    overfit=Adam(5e-4, final_rate_share=0.0),
    overfit_steps=100_000,
    finetune_steps=10_000,
)

# the published fits, trained through second derivatives that see the curvature of mean absolute errors
PAPER_SMOOTH = long_paper_recipe(PAPER, steps=960_000, hold_share=0.7, smoothing=0.2, validate_every=10_000)

RECIPES = {
    "paper": PAPER,
    "paper-long": long_paper_recipe(PAPER),
    "paper-smooth": PAPER_SMOOTH,
    "quick": QUICK,
    "full": FULL,
    "anisotropic": ANISOTROPIC,
}
