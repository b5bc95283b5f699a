"""The recipe of photographs whose General reads features of VGG-16, and of fits that go on from it."""

from __future__ import annotations

from dataclasses import replace

from metapp.apps.svbrdf_nonstationary.app import field_of
from metapp.apps.svbrdf_nonstationary.recipes import RECIPES
from metapp.extensions.pretrained.app import FromFeatures, wide_field
from metapp.learning.recipe import OuterLoop

_FULL = RECIPES["photo"]["full"]
SEARCHED = replace(_FULL.quickft, rate=8e-3, final=0.1)
PRETRAINED = replace(
    _FULL,
    app=FromFeatures(wide_field(field_of(256, 32))),
    quickft=SEARCHED,
    meta={"meta-encoder": replace(_FULL.meta["meta-encoder"], first=SEARCHED)},
    general=OuterLoop(steps=8_000, tasks=4, rates={"": 1e-3}, warmup=100, final=0.0, validate_every=1000),
)
