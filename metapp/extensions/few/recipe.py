"""The recipe of BRDFs with up to MOST samples, which may be noisy or lack grazing angles: one solve of all of them."""

from __future__ import annotations

from dataclasses import replace

from metapp.apps.brdf.recipes import FULL, RIDGE
from metapp.extensions.few.app import MOST, FewSamples

FEW = replace(
    FULL,
    steps=1,
    batch=MOST,
    meta={
        "ridge": replace(
            RIDGE,
            tasks=12,
            rates=RIDGE.rates | {f"encoder.encoder.{own}": 1e-2 for own in ("last", "deviation", "noise")},
            validate_every=1000,
            app=FewSamples(),
        )
    },
)
