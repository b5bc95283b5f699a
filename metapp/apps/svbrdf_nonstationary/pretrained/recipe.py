"""The recipe of non-stationary svBRDFs from one photograph by features of VGG-16, the default where its weights are.

The recipe is `full` but for the application, the training of General, and an Adam that was searched for it.
"""

from __future__ import annotations

from dataclasses import replace

from metapp.apps.svbrdf_nonstationary.app import FINEST_PX, SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.field_maps import field_of
from metapp.apps.svbrdf_nonstationary.pretrained.encoder import FeatureEncoder
from metapp.apps.svbrdf_nonstationary.pretrained.ensemble_maps import EnsembleMaps
from metapp.apps.svbrdf_nonstationary.pretrained.feature_judge import FeatureJudge
from metapp.apps.svbrdf_nonstationary.pretrained.feature_sight import FeatureSight
from metapp.apps.svbrdf_nonstationary.recipes import PHOTO_RECIPES
from metapp.learning.recipe import OuterLoop
from metapp.networks.field import LocalField


def of_features(network: LocalField) -> SvbrdfNonstationary:
    """Return the application whose fits of one photograph begin at General's maps by features of VGG-16."""
    decoder, sight = EnsembleMaps(network, "raised"), FeatureSight()
    return SvbrdfNonstationary(decoder, sight, FeatureJudge(), FeatureEncoder(), FINEST_PX)


FULL = PHOTO_RECIPES["full"]
SEARCHED = replace(FULL.quickft, rate=8e-3, final_rate_share=0.1)
PRETRAINED = replace(
    FULL,
    app=of_features(field_of(256, 32)),
    quickft=SEARCHED,
    meta={"meta-encoder": replace(FULL.meta["meta-encoder"], initial_adam=SEARCHED)},
    general=OuterLoop(
        steps=8_000, tasks=4, rates={"": 1e-3}, warmup_steps=100, final_rate_share=0.0, validate_every=1000
    ),
)
