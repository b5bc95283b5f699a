"""Baselines of non-stationary svBRDFs from a photo: the photo itself, flat, and maps that another method predicts."""

from __future__ import annotations

import torch
from torch import Generator, Tensor

from metapp.appearance.flash import Maps, unpack
from metapp.apps.svbrdf_nonstationary.maps import FLASH, flash_of, photographed
from metapp.extensions.baselines.baseline import Allowed, Baseline, BaselineFit, PreparedBaseline
from metapp.learning.app import App
from metapp.learning.task import Tasks

ROUGHNESS, F0 = 0.5, 0.04  # of what a photo says nothing of: the middle, and that of most dielectrics


def baselines(app: App) -> tuple[Baseline, ...]:
    """Of photographs; none of maps."""
    if app.protocol != "photo":
        return ()
    return (
        Baseline(
            "flat",
            f"the photo without the flash's falloff as diffuse map, flat, of roughness {ROUGHNESS} and F0 {F0}",
            "tell highlights and shading from colour",
            lambda *_: PreparedBaseline(_flat),
            learns=False,
        ),
        Baseline(
            "predicted",
            "the maps that another method predicts of the photo, as `metapp data strips --predicted` reads them",
            "be made of another photo here, as its network is not at hand",
            lambda *_: PreparedBaseline(_predicted, shared=None),
            learns=False,
            stored="predicted",
        ),
    )


def _flat(tasks: Tasks, rng: Generator, allowed: Allowed) -> BaselineFit:
    photo = tasks.data["photo"][tasks.rows]
    return BaselineFit(lambda: flat_maps(photo), photo.numel(), photo.numel())


def _predicted(tasks: Tasks, rng: Generator, allowed: Allowed) -> BaselineFit:
    if "predicted" not in tasks.data:
        (name,) = tasks.selected_names
        raise ValueError(f"{name}: no predicted maps, expected some; convert it by metapp data strips --predicted.")
    maps = tasks.data["predicted"][tasks.rows]
    return BaselineFit(lambda: unpack(maps), maps.numel(), maps.numel())


def flat_maps(photos: Tensor) -> Maps:
    """Maps [T, C, H, W] of photographs [T, 3, H, W], linear, as of a surface without highlight and relief."""
    one = torch.ones_like(photos)
    flat = Maps(one, F0 * one, ROUGHNESS * one[:, :1], torch.cat([0 * one[:, :2], one[:, :1]], 1))
    beside_lens = flash_of(photos.new_zeros(len(photos), FLASH))
    white = photographed(flat._replace(specular=0 * one, roughness=one[:, :1]), beside_lens)
    return flat._replace(diffuse=(photos / white).clamp(0, 1))
