"""Fits of several photographs of one material: each from its own place, which fits look for about the one given.

A batch holds the first photograph as `photo` [T, 3, H, W], the others as `others` [T, N - 1, 3, H, W], and `places`
[T, N, 2, 3], those of camera and flash as given, in half sides of the patch. A photograph without a place is one from
straight above.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d

from data_tools.synthetic.svbrdf_nonstationary import held_places
from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.flash import BRIGHTER, Maps, camera, camera_distance, positions, render, unpack
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary, photo_loss
from metapp.apps.svbrdf_nonstationary.maps import ACROSS, BRIGHT, CLIPPED_VALUE, FLASH, UP, Flash, linear, pooled
from metapp.apps.svbrdf_nonstationary.variants import varied
from metapp.learning.draws import normal
from metapp.learning.pictures import Picture, Visible
from metapp.learning.task import Batch, Params, Task, Tasks


class SeveralPhotos(SvbrdfNonstationary):
    """The same network and General; a fit sees all photographs, and moves camera and flash of each."""

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """The same, and `others`, linear, and `places`: tasks of different numbers of photographs cannot be stacked.

        Raises:
            ValueError: another number of places than of photographs.
        """
        others = task.data.get("others", torch.zeros(0, *task.data["photo"].shape, dtype=torch.uint8))
        places = task.data.get("places", torch.zeros(0, 2, 3)).float()
        if len(places) != len(others) + 1 and (len(places) or len(others)):
            raise ValueError(
                f"{task.name}: {len(others) + 1} photos and {len(places)} places, expected as many; convert it again."
            )
        size = (self.network.height, self.network.width)
        small = adaptive_avg_pool2d(linear(others), size) if len(others) else torch.zeros(0, 3, *size)
        above = camera().expand(1, 2, 3)
        return super().prepare(task) | {"others": small, "places": places if len(places) else above}

    def known(self, tasks: Tasks) -> Params:
        """Initial flashes."""
        places = tasks.data["places"][tasks.rows]
        return {"flash": places.new_zeros(len(places), FLASH, places.shape[1])}

    def _photo_loss(self, theta: Params, maps: Maps, batch: Batch, learned: Params) -> Tensor:
        flash = flashes_of(self.network.gain * theta["flash"], batch["places"])
        return photo_loss(radiance_of(maps, flash), all_photos(batch), learned)

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        """All photographs, whose brightness flashes begin with, though the encoder reads the first."""
        return {key: tasks.data[key][tasks.rows] for key in ("photo", "others", "places")}

    def encode(self, encoder: Params, condition: Batch) -> Params:
        """The code of the first: General knows none from aside, the mean of codes is worse."""
        theta = super().encode(encoder, condition)
        return theta | {"flash": first_flashes(self.maps_of(theta, condition["photo"]), condition) / self.network.gain}

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """The same materials turned, mirrored, mixed and recoloured, photographed anew."""
        size = (self.network.height, self.network.width)
        fine = varied(tasks.data["fine"][tasks.rows].float(), self.shot_size, rng)
        photos, places = drawn_photos(fine, tasks.data["places"].shape[1], rng)
        small = adaptive_avg_pool2d(photos.flatten(0, 1), size).unflatten(0, photos.shape[:2])
        data = self.described(pooled(fine, size))
        return tasks.variants({"photo": small[:, 0], "others": small[:, 1:], "places": places} | data)

    def remarks(self, task: Task, theta: Params) -> dict[str, dict[str, int]]:
        """The number of photographs."""
        return {"counts": {"photos": 1 + len(task.data.get("others", ()))}}

    def doubts(self, theta: Params, tasks: Tasks) -> list[list[str]]:
        """A highlight that clips in all photographs."""
        return super().doubts(theta, replace(tasks, data=tasks.data | {"photo": all_photos(tasks.data).amin(1)}))

    @torch.no_grad()
    def pictures(self, theta: Params, task: Task) -> dict[str, Picture]:
        """The same, and the maps in each photograph, `photo_1` and so on, from where the fit believes it was taken."""
        pictures, maps = super().pictures(theta, task), Maps(*(part[None] for part in self._whole(theta, task)))
        for number, flash in enumerate(self.flashes(theta, task), 1):
            radiance = radiance_of(maps, Flash(*(part[None, None] for part in flash)))[0, 0]
            pictures[f"photo_{number}"] = Picture(linear_to_srgb(radiance.clamp(0, 1)).permute(1, 2, 0), "srgb")
        return pictures

    def flashes(self, theta: Params, task: Task) -> list[Flash]:
        """The flash of each photograph, without task axis, as the fit places it."""
        places = task.data.get("places", camera().expand(1, 2, 3))[None].float()
        flash = flashes_of(self.network.gain * theta["flash"][None], places)
        return [Flash(*(part[0, number] for part in flash)) for number in range(places.shape[1])]

    def visible(self, task: Task) -> Visible:
        """All photographs, all of them in each step; General's encoder reads the first."""
        return Visible(1 + len(task.data.get("others", ())), task.data["photo"].nbytes, 1)


def all_photos(batch: Batch) -> Tensor:
    """The photographs [T, N, 3, H, W]."""
    return torch.cat([batch["photo"][:, None], batch["others"]], 1)


def flashes_of(flash: Tensor, places: Tensor) -> Flash:
    """Flashes, with an axis [T, N, ...], of their descriptions [T, FLASH, N] about given places [T, N, 2, 3].

    Zeros say: there, and white right below the flash is 1. People hold camera and flash together, so that both move.
    """
    aside, higher, brighter = flash.mT.split((2, 1, 1), -1)
    higher = torch.exp(UP * higher)
    eye, place = torch.cat(
        [places[..., :2] + ACROSS * aside[:, :, None], places[..., 2:] * higher[:, :, None]], -1
    ).unbind(2)
    return Flash(place, torch.exp(BRIGHT * brighter) * (place[..., 2:] / camera_distance()) ** 2, eye)


def radiance_of(maps: Maps, flashes: Flash) -> Tensor:
    """Radiance [T, N, 3, H, W] of maps [T, ...] under each flash."""
    like = maps.diffuse
    place = positions(*like.shape[-2:], dtype=like.dtype, device=like.device)
    each = Maps(*(part[:, None] for part in maps))
    return render(each, place, flashes.place, flashes.eye, intensity=flashes.gain)


def first_flashes(maps: Maps, batch: Batch) -> Tensor:
    """Initial flashes of fits, [T, FLASH, N]: at the places given.

    Each as bright as it must be for General's maps to have the photograph's mean where that does not clip: cameras
    expose each photograph anew, and General takes the first for a calibrated one.
    """
    places, photos = batch["places"], all_photos(batch)
    none = places.new_zeros(len(places), FLASH, places.shape[1])
    radiance = radiance_of(Maps(*(part.detach() for part in maps)), flashes_of(none, places))
    whole = (photos < CLIPPED_VALUE).to(photos)
    gain = (photos * whole).sum((2, 3, 4)).clamp_min(1e-6) / (radiance * whole).sum((2, 3, 4)).clamp_min(1e-6)
    return torch.cat([none[:, :-1], gain.log()[:, None] / BRIGHT], 1)


def drawn_photos(maps: Tensor, count: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Photographs [T, count, 3, S, S], linear, of 8 bits, of maps [T, 10, S, S], and the places that are given."""
    places, off = held_places(len(maps), count, rng)
    true, measured = (each[:, :, None].expand(-1, -1, 2, -1) for each in (places, places + off))
    brighter = BRIGHTER / BRIGHT * normal(rng, len(maps), 1, count)
    flash = torch.cat([brighter.new_zeros(len(maps), FLASH - 1, count), brighter], 1)
    display = linear_to_srgb(radiance_of(unpack(maps), flashes_of(flash, true)).clamp(0, 1))
    return srgb_to_linear((display * 255).round() / 255), measured
