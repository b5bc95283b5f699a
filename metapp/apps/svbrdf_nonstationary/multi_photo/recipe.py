"""The recipe of non-stationary svBRDFs from several photographs: maps of each texel, begun by photometric stereo.

The recipe holds numbers of steps and rates alone; a step itself is in
`metapp.apps.svbrdf_nonstationary.multi_photo.newton`.
"""

from __future__ import annotations

from dataclasses import replace

from metapp.apps.svbrdf_nonstationary.app import FINEST_PX, SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.multi_photo.photo_set_sight import PhotoSetSight
from metapp.apps.svbrdf_nonstationary.multi_photo.stereo_encoder import StereoEncoder
from metapp.apps.svbrdf_nonstationary.multi_photo.texel_judge import TexelJudge
from metapp.apps.svbrdf_nonstationary.multi_photo.texel_maps import TexelMaps
from metapp.apps.svbrdf_nonstationary.recipes import GENTLE, PHOTO_RECIPES
from metapp.learning.recipe import Adam, OuterLoop


def of_several(height: int, width: int) -> SvbrdfNonstationary:
    """Return the application whose fits see several photographs, with maps of height x width texels."""
    return SvbrdfNonstationary(TexelMaps(height, width), PhotoSetSight(), TexelJudge(), StereoEncoder(), FINEST_PX)


SEVERAL = replace(
    PHOTO_RECIPES["full"],
    app=of_several(256, 256),
    steps=8,
    overfit_steps=300,
    overfit=Adam(0.05, beta1=0.9, beta2=0.95, final_rate_share=0.0),
    finetune_steps=100,
    finetune=Adam(0.02, beta1=0.9, beta2=0.95, eps=2e-3, final_rate_share=0.1),
    quickft=Adam(0.05, beta1=0.5, beta2=0.95, eps=2e-3, final_rate_share=0.1),
    general=OuterLoop(steps=4200, tasks=8, rates={"": 1.5e-3}, warmup_steps=100, final_rate_share=0.01),
    meta={
        "gauss-newton": replace(
            GENTLE,
            steps=200,
            tasks=4,
            rates={"": 0.0, "alpha.": 5e-2},
            final_rate_share=0.02,
            warmup_steps=5,
            validate_every=20,
            clip=0.05,
        )
    },
    rule="gauss-newton",
)
