"""The recipes of non-stationary svBRDFs whose General is trained without features of VGG-16.

The recipes `pretrained` and `several`, which begin at these, are in packages of their names.
"""

from __future__ import annotations

from dataclasses import replace

from metapp.apps.photo_recipes import recipes_of_references_and_photos
from metapp.apps.svbrdf_nonstationary.app import FINEST_PX, SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.encoder import PhotoEncoder
from metapp.apps.svbrdf_nonstationary.field_judge import FieldJudge
from metapp.apps.svbrdf_nonstationary.field_maps import FieldMaps, field_of
from metapp.apps.svbrdf_nonstationary.maps_sight import MapsSight
from metapp.apps.svbrdf_nonstationary.photo_sight import PhotoSight
from metapp.learning.recipe import Adam, Guard, MetaTraining, OuterLoop, Recipe

# Rules are trained with exact second order from General's encoder, which goes on learning through the steps of fits.
LEARNED = MetaTraining(
    steps=600,
    tasks=4,
    rates={"": 5e-5, "alpha.": 5e-3, "alpha.within.": 5e-4},
    initial_adam=Adam(3e-3, beta1=0.5, beta2=0.8, eps=1e-6, final_rate_share=0.1),
    warmup_steps=10,
    final_rate_share=0.01,
    order=2,
    clip=1.0,
    validate_every=50,
    initialisation="encoder",
    guard=Guard(
        Adam(6e-4, beta1=0.5, beta2=0.9, eps=1e-6, final_rate_share=0.1), max_loss_share=0.4, max_rise_factor=2.0
    ),
)
QUICK_APP = SvbrdfNonstationary(FieldMaps(field_of(64, 32)), MapsSight(), FieldJudge(), PhotoEncoder())
QUICK = Recipe(
    steps=15,
    samples=1,
    overfit_steps=1000,
    overfit=Adam(3e-3, beta2=0.99, final_rate_share=0.0),
    finetune_steps=100,
    finetune=Adam(3e-3, final_rate_share=0.0),
    quickft=Adam(3e-3, beta1=0.6, beta2=0.98, final_rate_share=0.1),
    general=OuterLoop(
        steps=24_000, tasks=8, rates={"": 1e-3}, warmup_steps=100, final_rate_share=0.0, validate_every=1000
    ),
    meta={"meta-encoder": LEARNED, "meta-lgd": LEARNED},
    rule="meta-lgd",
    app=QUICK_APP,
)
# A photograph says little that General has not read from it: steps are small, and training through them is short.
GENTLE = replace(
    LEARNED, steps=50, tasks=8, initial_adam=Adam(3e-4, beta1=0.8, beta2=0.8, eps=1e-3), validate_every=25, guard=None
)
PHOTO = replace(
    QUICK,
    app=replace(QUICK_APP, sight=PhotoSight()),
    finetune=Adam(1e-4, final_rate_share=0.0),
    quickft=GENTLE.initial_adam,
    meta={"meta-encoder": GENTLE},
    rule="meta-encoder",
)
FINER_CHANNELS = (16, 12)  # channels of the encoder's levels of 128 and 256 texels
REFERENCE_RECIPES, PHOTO_RECIPES = recipes_of_references_and_photos(
    QUICK,
    PHOTO,
    full=[
        # the code that is read at 64 texels, and what rules learned there, on a finer grid
        replace(QUICK_APP, decoder=FieldMaps(field_of(128, 32)), encoder=PhotoEncoder(size=64), read_px=FINEST_PX),
        # photographs at the size that people use, by an encoder with levels for it
        SvbrdfNonstationary(
            FieldMaps(field_of(256, 32), "raised"),
            PhotoSight(fills=True),
            FieldJudge(),
            PhotoEncoder(finer=FINER_CHANNELS),
            FINEST_PX,
        ),
    ],
    # Fischer & Ritschel 2022, section 4.1.4: 15 inner steps
    paper=[
        SvbrdfNonstationary(FieldMaps(field_of(256, 64)), sight, FieldJudge(), PhotoEncoder(64))
        for sight in (MapsSight(), PhotoSight())
    ],
)
# 64 texels a side, at which an outer step takes seconds on CPUs
REFERENCE_RECIPES["paper-64"] = replace(
    REFERENCE_RECIPES["paper"],
    app=SvbrdfNonstationary(FieldMaps(field_of(64, 64)), MapsSight(), FieldJudge(), PhotoEncoder(64)),
)
# 20 outer steps of training a rule raised validation errors, so that the rule is an Adam that is searched for.
SEARCHED = Adam(6e-4, beta1=0.8, beta2=0.8, eps=1e-3)
PHOTO_RECIPES["full"] = replace(
    PHOTO_RECIPES["full"],
    quickft=SEARCHED,
    general=OuterLoop(
        steps=12_000, tasks=4, rates={"": 5e-4}, warmup_steps=50, final_rate_share=0.0, validate_every=1000
    ),
    meta={
        "meta-encoder": replace(GENTLE, steps=0, tasks=0, rates={"": 0.0}, initial_adam=SEARCHED, searches_adam=True)
    },
)
