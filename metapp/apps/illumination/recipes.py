"""The recipes of the application illumination: networks, sizes and rates of training, each with its reason.

There are two tables of recipes: of fits of a map itself, and of fits of the photograph of a sphere.
"""

from __future__ import annotations

from dataclasses import replace

from metapp.apps.illumination.app import Illumination
from metapp.apps.illumination.ball_sight import BallSight
from metapp.apps.illumination.lighting import LightField
from metapp.apps.illumination.map_sight import MapSight
from metapp.apps.photo_recipes import recipes_of_references_and_photos
from metapp.learning.recipe import Adam, Guard, MetaTraining, OuterLoop, Recipe, long_paper_recipe
from metapp.networks.field import LocalField

# exact second order, from General's encoder, which goes on learning through the steps
LEARNED = MetaTraining(
    steps=1500,
    tasks=8,
    rates={"": 1e-4, "alpha.": 5e-3, "alpha.around.": 5e-4},
    initial_adam=Adam(1.2e-2, beta1=0.6, beta2=0.98, eps=1e-4, final_rate_share=0.1),
    warmup_steps=50,
    final_rate_share=0.01,
    order=2,
    clip=1.0,
    validate_every=100,
    initialisation="encoder",
    # a fit is doubtful if its final over its initial loss is twice as large as for any validation map, or if late steps
    # double its loss: they are too long for the radiance of a sun, and overshoot it
    guard=Guard(
        Adam(2e-3, beta1=0.5, beta2=0.9, eps=1e-6, final_rate_share=0.1), max_loss_share=0.5, max_rise_factor=2.0
    ),
)
QUICK = Recipe(
    steps=15,
    samples=1,
    overfit_steps=3000,
    overfit=Adam(1e-2, final_rate_share=0.0),
    finetune_steps=300,
    finetune=Adam(1e-2, final_rate_share=0.0),
    quickft=Adam(1e-2, beta1=0.6, beta2=0.98, final_rate_share=0.1),
    general=OuterLoop(
        steps=9000, tasks=16, rates={"": 1e-3}, warmup_steps=100, final_rate_share=0.0, validate_every=500
    ),
    meta={"meta-encoder": LEARNED, "meta-lgd": LEARNED},
    rule="meta-lgd",
    app=Illumination(LightField(LocalField(32, 64)), MapSight()),
)
# from photographs training is slow and long: the encoder has much to learn, and what to leave to the steps
PHOTO_TRAINING = replace(
    LEARNED,
    steps=3000,
    rates={"": 1e-4, "alpha.": 1e-2},
    initial_adam=Adam(1e-3, beta1=0.7, beta2=0.99, eps=1e-3, final_rate_share=0.1),
    warmup_steps=20,
    guard=None,  # a lower loss of a photograph need not be a better map
)
PHOTO = replace(
    QUICK,
    app=Illumination(LightField(LocalField(32, 64)), BallSight()),
    overfit=Adam(1e-3, final_rate_share=0.0),
    finetune=Adam(1e-4, final_rate_share=0.0),
    quickft=Adam(3e-4, beta1=0.7, beta2=0.99, eps=1e-3, final_rate_share=0.1),
    meta={"meta-encoder": PHOTO_TRAINING},
    rule="meta-encoder",
)
SIGHTS = (MapSight(), BallSight())
REFERENCE_RECIPES, PHOTO_RECIPES = recipes_of_references_and_photos(
    QUICK,
    PHOTO,
    # at the size that people use, with a fifth as many parameters as a map has numbers: what was learned for 32 x 64
    # texels, on a finer grid
    full=[Illumination(LightField(LocalField(128, 256, rows=32, columns=64)), sight) for sight in SIGHTS],
    # Fischer & Ritschel 2022, section 4.1.5: 15 inner steps
    paper=[Illumination(LightField(LocalField(64, 128, hidden=64)), sight) for sight in SIGHTS],
)
# at a rate of 1e-3, which other applications have, losses are not finite after 439 steps
REFERENCE_RECIPES["paper-long"] = long_paper_recipe(REFERENCE_RECIPES["paper"], 3e-4)
