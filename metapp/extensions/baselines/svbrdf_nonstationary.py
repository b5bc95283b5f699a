"""Baselines of non-stationary svBRDFs from a photo: the photo itself, flat, and maps that another method predicts."""

from __future__ import annotations

import torch
from torch import Generator, Tensor

from metapp.appearance.flash import Maps, unpack_maps
from metapp.apps.svbrdf_nonstationary.maps import FLASH_NUMBERS, decode_flash, render_photo
from metapp.extensions.baselines.baseline import Baseline, BaselineFit, CostLimits
from metapp.learning.app import App
from metapp.learning.task import Tasks

FLAT_ROUGHNESS, FLAT_F0 = 0.5, 0.04  # of what a photo says nothing of: the middle, and that of most dielectrics


def baselines(app: App) -> tuple[Baseline, ...]:
    """Of photographs; none of maps."""
    return (FlatMaterial(app), PredictedMaps(app)) if app.protocol == "photo" else ()


class FlatMaterial(Baseline):
    """The photograph as a flat material."""

    name = "flat"
    title = (
        f"the photo without the flash's falloff as diffuse map, flat, of roughness {FLAT_ROUGHNESS} and F0 {FLAT_F0}"
    )
    cannot = "tell highlights and shading from colour"

    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        """The photograph itself is kept."""
        photo = tasks.data["photo"][tasks.rows]
        return BaselineFit(lambda: flat_maps(photo), photo.numel(), photo.numel())


class PredictedMaps(Baseline):
    """The maps that another method predicts."""

    name = "predicted"
    title = "the maps that another method predicts of the photo, as `metapp data strips --predicted` reads them"
    cannot = "be made of another photo here, as its network is not at hand"
    stored = "predicted"
    shared = None

    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        """The maps of a task; ValueError if it has none."""
        if "predicted" not in tasks.data:
            (name,) = tasks.selected_names
            raise ValueError(f"{name}: no predicted maps, expected some; convert it by metapp data strips --predicted.")
        maps = tasks.data["predicted"][tasks.rows]
        return BaselineFit(lambda: unpack_maps(maps), maps.numel(), maps.numel())


def flat_maps(photos: Tensor) -> Maps:
    """Maps [T, C, H, W] of photographs [T, 3, H, W], linear, as of a surface without highlight and relief."""
    one = torch.ones_like(photos)
    flat = Maps(one, FLAT_F0 * one, FLAT_ROUGHNESS * one[:, :1], torch.cat([0 * one[:, :2], one[:, :1]], 1))
    beside_lens = decode_flash(photos.new_zeros(len(photos), FLASH_NUMBERS))
    white = render_photo(flat._replace(specular=0 * one, roughness=one[:, :1]), beside_lens)
    return flat._replace(diffuse=(photos / white).clamp(0, 1))
