"""Baselines of non-stationary svBRDFs from one photograph: the photograph as a flat material, and predicted maps.

Another method has made the predicted maps, which were converted with the tasks; no such method is run here.
"""

from __future__ import annotations

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.assets import Surface
from metapp.appearance.svbrdf_maps import Maps, unpack_maps
from metapp.apps.svbrdf_nonstationary.flashes import FLASH_NUMBERS, decode_flash, render_photo
from metapp.extensions.baselines.baseline import Baseline, BaselineFit, CostLimits
from metapp.learning.app import App
from metapp.learning.task import Tasks

FLAT_ROUGHNESS, FLAT_F0 = 0.5, 0.04  # a photo does not tell these: the middle, and the F0 of most dielectrics


def baselines(app: App) -> tuple[Baseline, ...]:
    """Return the baselines of fits that observe a photograph; fits that observe maps have none."""
    return (FlatMaterial(app), PredictedMaps(app)) if app.observes == "photo" else ()


class FlatMaterial(Baseline):
    """The photograph as a flat material; a fit stores the photograph."""

    name = "flat"
    title = (
        f"the photo without the flash's falloff as diffuse map, flat, of roughness {FLAT_ROUGHNESS} and F0 {FLAT_F0}"
    )
    cannot = "tell highlights and shading from colour"

    @override
    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        photo = tasks.data["photo"][tasks.rows]
        return BaselineFit(
            lambda: flat_maps(photo), photo.numel(), photo.numel(), lambda task, size: surface_of(flat_maps(photo))
        )


class PredictedMaps(Baseline):
    """The maps that another method predicted and that tasks hold."""

    name = "predicted"
    title = "the maps that another method predicts of the photo, as `metapp data strips --predicted` reads them"
    cannot = "be made of another photo here, as its network is not at hand"
    stored_tensor = "predicted"
    shared_bytes = None

    @override
    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        """Raise ValueError if the task has no predicted maps."""
        if "predicted" not in tasks.data:
            (name,) = tasks.selected_names
            raise ValueError(f"{name}: no predicted maps, expected some; convert it by metapp data strips --predicted.")
        packed = tasks.data["predicted"][tasks.rows]
        maps = unpack_maps(packed)
        return BaselineFit(lambda: maps, packed.numel(), packed.numel(), lambda task, size: surface_of(maps))


def surface_of(maps: Maps) -> Surface:
    """Return the surface of maps [1, C, H, W]."""
    return Surface(Maps(*(part[0] for part in maps)), tiles=False)


def flat_maps(photos: Tensor) -> Maps:
    """Return maps of a flat surface without highlight that looks like a photograph, but for the flash's falloff.

    Args:
        photos: the photographs, linear [T, 3, H, W].

    Returns:
        The maps, [T, C, H, W], with roughness FLAT_ROUGHNESS and F0 FLAT_F0.
    """
    ones = torch.ones_like(photos)
    flat = Maps(ones, FLAT_F0 * ones, FLAT_ROUGHNESS * ones[:, :1], torch.cat([0 * ones[:, :2], ones[:, :1]], 1))
    beside_lens = decode_flash(photos.new_zeros(len(photos), FLASH_NUMBERS))
    white = render_photo(flat._replace(specular=0 * ones, roughness=ones[:, :1]), beside_lens)
    return flat._replace(diffuse=(photos / white).clamp(0, 1))
