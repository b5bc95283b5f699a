"""Several photographs of one material: what each shows of it, from its own place, and how they are drawn.

A batch holds the first one as `photo` [T, 3, H, W], the others as `others` [T, N - 1, 3, H, W], and `places`
[T, N, 2, 3], those of camera and flash as given, in half sides of the patch. N is 0 where there is one photograph
without a place, from straight above.
"""

from __future__ import annotations

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.flash import BRIGHTER, Maps, unpack
from metapp.appearance.several import held_places
from metapp.apps.svbrdf_nonstationary.maps import BRIGHT, CLIPPED_VALUE, FLASH, flashes_of, linear, photographed
from metapp.learning.draws import normal
from metapp.learning.task import Batch, Task

KEYS = ("others", "places")


def several(batch: Batch) -> bool:
    """True if photographs have places of their own."""
    return "places" in batch and batch["places"].shape[1] > 0


def prepared(task: Task, size: tuple[int, int]) -> Batch:
    """`others`, linear, and `places` of a task, without a task axis; of no entries where it has none.

    So tasks of different numbers of photographs cannot be stacked.

    Raises:
        ValueError: one without the other, or another number of places.
    """
    photos = len(task.data["others"]) + 1 if "others" in task.data else 1
    places = len(task.data["places"]) if "places" in task.data else 0
    if places != photos and (places or photos > 1):
        raise ValueError(f"{task.name}: {photos} photos and {places} places, expected as many; convert it again.")
    if not places:
        return {"others": torch.zeros(0, 3, *size), "places": torch.zeros(0, 2, 3)}
    others = task.data.get("others", torch.zeros(0, 3, *size, dtype=torch.uint8))
    shrunk = adaptive_avg_pool2d(linear(others), size) if len(others) else linear(others)
    return {"others": shrunk, "places": task.data["places"].float()}


def all_photos(batch: Batch) -> Tensor:
    """The photographs [T, N, 3, H, W]; [T, 3, H, W] of one without a place."""
    return torch.cat([batch["photo"][:, None], batch["others"]], 1) if several(batch) else batch["photo"]


def first_flashes(maps: Maps, batch: Batch) -> Tensor:
    """Where fits of several photographs begin to look for their flashes, [T, FLASH, N]: at the places given.

    Each as bright as it must be for General's maps to have the photograph's mean where that does not clip: cameras
    expose each photograph anew, and General takes the first for a calibrated one.
    """
    places, photos = batch["places"], all_photos(batch)
    none = places.new_zeros(len(places), FLASH, places.shape[1])
    radiance = photographed(Maps(*(part.detach() for part in maps)), flashes_of(none, places))
    whole = (photos < CLIPPED_VALUE).to(photos)
    gain = (photos * whole).sum((2, 3, 4)).clamp_min(1e-6) / (radiance * whole).sum((2, 3, 4)).clamp_min(1e-6)
    return torch.cat([none[:, :-1], gain.log()[:, None] / BRIGHT], 1)


def drawn_photos(maps: Tensor, count: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Photographs [T, count, 3, S, S], linear, of 8 bits, of maps [T, 10, S, S], and the places that are given."""
    places, off = held_places(len(maps), count, rng)
    true, measured = (each[:, :, None].expand(-1, -1, 2, -1) for each in (places, places + off))
    brighter = BRIGHTER / BRIGHT * normal(rng, len(maps), 1, count)
    flash = torch.cat([brighter.new_zeros(len(maps), FLASH - 1, count), brighter], 1)
    display = linear_to_srgb(photographed(unpack(maps), flashes_of(flash, true)).clamp(0, 1))
    return srgb_to_linear((display * 255).round() / 255), measured
