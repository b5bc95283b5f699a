"""The recipe of photographs whose General reads features of VGG-16: fits are those of "full"."""

from __future__ import annotations

from dataclasses import replace

from metapp.apps.svbrdf_nonstationary.app import field_of
from metapp.apps.svbrdf_nonstationary.recipes import RECIPES
from metapp.extensions.pretrained.app import PretrainedSetup
from metapp.learning.recipe import OuterLoop

PRETRAINED = replace(
    RECIPES["photo"]["full"],
    setup=PretrainedSetup(field_of(256, 32)),
    general=OuterLoop(steps=8_000, tasks=4, rates={"": 1e-3}, warmup=100, final=0.0, validate_every=1000),
)
