"""Fits of several photographs of one material: maps of each texel, and the flash of each photograph.

A batch holds the photographs as `photos` [T, N, 3, H, W], linear, and `places` [T, N, 2, 3], those of camera and flash
as given, in half sides of the patch. A photograph without a place is one from straight above.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, interpolate, relu
from typing_extensions import override

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.flash import Maps, camera, camera_distance, positions, render, unpack
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.maps import (
    ACROSS,
    BRIGHT,
    CLIPPED_VALUE,
    FLASH,
    RAW,
    UP,
    Flash,
    decoded,
    differences,
    linear,
    pooled,
    raw_roughness,
)
from metapp.apps.svbrdf_nonstationary.places import held_places
from metapp.apps.svbrdf_nonstationary.several import encoder as reader
from metapp.apps.svbrdf_nonstationary.several.height import levelled
from metapp.apps.svbrdf_nonstationary.variants import draws_of, varied
from metapp.learning.rules import append_axes
from metapp.learning.task import Batch, Params, Task, Tasks

FLOOR = 0.03  # of white: the log of radiance is flat below
SMOOTHED, PRIOR, MOVED = 0.02, 0.04, 0.02  # of the loss: rounding of |d|, weights of the prior and of moved flashes
LIKELIHOOD = 0.05  # weight of the deviations' likelihood in the outer loss
ROUGHNESSES = (0.15, 0.25, 0.35, 0.5, 0.7)  # of a whole material, one of which Overfit begins with
SEARCH_PX = 64  # a side of the photographs that this is judged on
# Augmented photographs: shares of materials photographed by hand from all sides, and of photographs exposed anew
BY_HAND, EXPOSED, STOPS = 0.6, 0.3, 0.35
STEEPEST_TILT = math.radians(36)


class Texels(NamedTuple):
    """Maps that are parameters, RAW numbers of each texel."""

    height: int
    width: int
    periodic: bool = False

    def init(self, rng: Generator, count: int) -> Params:
        """Flat grey maps [count, 9, height, width]."""
        return {"maps": torch.zeros(count, sum(RAW), self.height, self.width, device=rng.device)}


@dataclass(frozen=True)
class SeveralPhotos(SvbrdfNonstationary):
    """The same materials and errors; a fit sees all photographs, and has a parameter for each number of a texel.

    Fits that begin at General's maps keep these as a prior: `prior` [T, 18, H, W] has its RAW numbers, and the logs of
    the scales by which they are off.
    """

    network: Texels = field(default=Texels(256, 256))
    protocol: str = field(default="photo", kw_only=True)
    sees_others = True

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """The same, and `photos`, linear, on the surface, and `places`: tasks of different numbers are not stacked.

        Raises:
            ValueError: another number of places than of photographs.
        """
        photos = torch.stack([task.data["photo"], *task.data.get("others", ())])
        places = task.data.get("places", camera().expand(1, 2, 3)).float()
        if len(places) != len(photos):
            raise ValueError(
                f"{task.name}: {len(photos)} photos and {len(task.data.get('places', ()))} places, expected as many; "
                "convert it again."
            )
        small = adaptive_avg_pool2d(linear(photos), (self.network.height, self.network.width))
        return super().prepare(task) | {"photos": levelled(small, places), "places": places}

    def task_parameters(self, tasks: Tasks) -> Params:
        """The closed form's maps of one roughness, by which all photographs look most alike, and their flashes."""
        batch, network = self.condition(tasks, Generator()), self.network
        size = (min(SEARCH_PX, network.height), min(SEARCH_PX, network.width))
        batch["photos"] = _pooled(batch["photos"], size)
        slopes, diffuse, rough, specular = reader.read(**batch).maps.split(RAW, 1)
        thetas, losses = [], []
        for roughness in ROUGHNESSES:
            level = torch.full_like(rough, math.log((roughness - 0.05) / (1 - roughness)))
            maps = torch.cat([slopes, diffuse, level, specular], 1)
            thetas.append({"maps": maps, "flash": exposed(decoded(maps), batch)})
            losses.append(self.loss(thetas[-1], batch, {}))
        best = torch.stack(losses).argmin(0), torch.arange(len(tasks), device=tasks.rows.device)
        theta = {key: torch.stack([each[key] for each in thetas])[best] for key in thetas[0]}
        return theta | {"maps": interpolate(theta["maps"], (network.height, network.width), mode="bilinear")}

    def maps_of(self, theta: Params, photo: Tensor) -> Maps:
        """The maps at the resolution of a photograph, whose finer detail the diffuse colour takes."""
        size = photo.shape[-2:]
        if size == theta["maps"].shape[-2:]:
            return decoded(theta["maps"])
        maps, logs = decoded(interpolate(theta["maps"], size, mode="bicubic")), _logs(photo)
        coarse = adaptive_avg_pool2d(logs, (self.network.height, self.network.width))
        detail = logs - interpolate(coarse, size, mode="bicubic")
        return maps._replace(diffuse=(maps.diffuse * detail.exp()).clamp(0, 1))

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Of logs of photographs, of flashes that moved, and of the prior if there is one: sums over texels, [T]."""
        learned = self.settings(learned, theta["maps"])
        photos = batch["photos"]
        short = _logs(photos) - _logs(radiance_of(decoded(theta["maps"]), flashes_of(theta["flash"], batch["places"])))
        short = torch.where(photos > CLIPPED_VALUE, relu(short), short)
        loss = _rounded(short, learned["smoothing"].exp()).mean((1, 2, 3, 4))
        loss = loss + learned["flash"].exp() * theta["flash"][:, :3].square().mean((1, 2))
        if "prior" in theta:
            mean, deviation = theta["prior"].detach().chunk(2, 1)
            off = _rounded((theta["maps"] - mean) * (-deviation).exp(), photos.new_ones(())).mean((2, 3))
            loss = loss + (off * learned["prior"].exp()).sum(1) / photos.shape[1]
        return loss * (photos.shape[-2] * photos.shape[-1])

    def settings(self, learned: Params, like: Tensor) -> Params:
        """The learned parameters of the loss [T, ...], or those before training."""
        return learned or {
            key: value.expand(len(like), *value.shape[1:]).to(like) for key, value in self.loss_parameters(1).items()
        }

    def loss_parameters(self, steps: int) -> Params:
        """Logs of the rounding of |d|, and of the weights of the prior, of each number, and of moved flashes."""
        values = {
            "smoothing": torch.tensor(SMOOTHED),
            "prior": torch.full((sum(RAW),), PRIOR),
            "flash": torch.tensor(MOVED),
        }
        return {key: value.log().expand(steps, *value.shape).clone() for key, value in values.items()}

    def outer_loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Of the maps, normals most of all, their radiance under any light, and the prior's deviations, [T]."""
        maps, target = decoded(theta["maps"]), unpack(batch["maps"])
        logs, references = (self.log_radiance(each, batch["pairs"]) for each in (maps, target))
        diffuse, specular, roughness, normal = (each.abs().mean((1, 2, 3)) for each in differences(maps, target))
        slopes = (_slopes(maps.normal) - _slopes(target.normal)).abs().mean((1, 2, 3))
        tilted = target.normal[:, :2].abs().sum(1).mean((1, 2)) / 3
        loss = 0.5 * (logs - references).abs().mean((1, 2, 3, 4)) + 2 * normal + 0.15 * normal / (tilted + 0.03)
        loss = loss + 0.5 * slopes + 0.7 * diffuse + 0.5 * specular + roughness
        mean, deviation = theta["prior"].chunk(2, 1)
        off = (mean - _encoded(target)).detach().abs() * (-deviation).exp() + deviation
        return loss + LIKELIHOOD * off.mean((1, 2, 3))

    def init_encoder(self, rng: Generator) -> Params:
        """The network's parameters."""
        return reader.init(rng)

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        """All photographs and their places."""
        return {key: tasks.data[key][tasks.rows] for key in ("photos", "places")}

    def encode(self, encoder: Params, condition: Batch) -> Params:
        """General's maps, flashes as bright as these ask for, and the prior."""
        maps, deviation = reader.network(encoder, reader.read(**condition))
        wide = [part.expand(-1, count, -1, -1) for part, count in zip(deviation.split(1, 1), RAW, strict=True)]
        return {"maps": maps, "flash": exposed(decoded(maps), condition), "prior": torch.cat([maps, *wide], 1)}

    def postprocess(self, theta: Params) -> Params:
        """Without the prior."""
        return {key: value for key, value in theta.items() if key != "prior"}

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """The same materials turned, mirrored, mixed and recoloured, photographed anew."""
        size = (self.network.height, self.network.width)
        fine = varied(tasks.data["fine"][tasks.rows].float(), self.shot_size, rng)
        photos, places = drawn_photos(fine, tasks.data["places"].shape[1], rng)
        small = _pooled(photos, size)
        return tasks.variants(
            {"photo": small[:, 0], "photos": small, "places": places} | self.described(pooled(fine, size))
        )

    @override
    def flashes(self, theta: Params, task: Task) -> list[Flash]:
        places = task.data.get("places", camera().expand(1, 2, 3))[None].float()
        flash = flashes_of(theta["flash"][None], places)
        return [Flash(*(part[0, number] for part in flash)) for number in range(places.shape[1])]


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


@torch.no_grad()
def exposed(maps: Maps, batch: Batch) -> Tensor:
    """Flashes [T, FLASH, N] at the places given, as bright as maps [T, ...] ask for: medians where nothing clips."""
    places, photos = batch["places"], batch["photos"]
    none = places.new_zeros(len(places), FLASH, places.shape[1])
    off = _logs(photos) - _logs(radiance_of(maps, flashes_of(none, places)))
    off = torch.where(photos > CLIPPED_VALUE, 0, off).mean(2).flatten(2).median(2).values
    return torch.cat([none[:, :-1], off[:, None] / BRIGHT], 1)


def drawn_photos(maps: Tensor, count: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Photographs [T, count, 3, S, S], linear, of 8 bits, of maps [T, 10, S, S], and the places that are given.

    Held over the patch or tilted by hand from all sides; places up to 3 % off; exposed alike, or anew each time.
    """
    uniform, normal = draws_of(len(maps), rng)
    held, off = held_places(len(maps), count, rng)
    turn = 2 * math.pi * (torch.arange(count, device=rng.device)[None, :, None] / max(count - 1, 1) + uniform(1, 1))
    turn, tilt = turn + 0.4 * normal(count, 1), 0.1 + (STEEPEST_TILT - 0.1) * uniform(count, 1)
    tilt = torch.cat([0.15 * tilt[:, :1], tilt[:, 1:]], 1)  # the first from about straight above
    far = camera_distance() * (0.75 + 0.5 * uniform(count, 1)) * (1 + uniform(1, 1))
    tilted = far * torch.cat([tilt.sin() * turn.cos(), tilt.sin() * turn.sin(), tilt.cos()], -1)
    true = torch.where(uniform(1, 1) < BY_HAND, tilted, held)
    measured = true + 1.5 * uniform(1, 1) * off
    level = torch.where(uniform(1) < EXPOSED, STOPS * normal(count) - 0.15, 0.06 * normal(count))
    flash = torch.cat([level.new_zeros(len(maps), FLASH - 1, count), level[:, None] / BRIGHT], 1)
    both = true[:, :, None].expand(-1, -1, 2, -1)
    display = linear_to_srgb(radiance_of(unpack(maps), flashes_of(flash, both)).clamp(0, 1))
    display = display + 0.01 * uniform(1, 1, 1, 1) * torch.randn(display.shape, generator=rng, device=rng.device)
    photos = srgb_to_linear((display.clamp(0, 1) * 255).round() / 255)
    return photos, measured[:, :, None].expand(-1, -1, 2, -1)


def _pooled(photos: Tensor, size: tuple[int, int]) -> Tensor:
    small: Tensor = adaptive_avg_pool2d(photos.flatten(0, 1), size).unflatten(0, photos.shape[:2])
    return small


def _logs(radiance: Tensor) -> Tensor:
    return (radiance + FLOOR).log()


def _rounded(difference: Tensor, s: Tensor) -> Tensor:
    """sqrt(d^2 + s^2) - s, s [T] or one number."""
    s = append_axes(s, difference)
    return (difference * difference + s * s).sqrt() - s


def _slopes(normal: Tensor) -> Tensor:
    return normal[:, :2] / normal[:, 2:].clamp_min(0.2)


def _encoded(maps: Maps) -> Tensor:
    """RAW numbers [T, 9, H, W] of maps, the inverse of `decoded` but at the ends of ranges."""
    logit = torch.logit
    diffuse, specular = (maps.diffuse.clamp(1e-4, 1) ** (1 / 2.2), maps.specular.clamp(1e-4, 1).sqrt())
    slopes = maps.normal[:, :2] / maps.normal[:, 2:].clamp_min(0.1)
    roughness = raw_roughness(maps.roughness)
    return torch.cat([slopes, logit(diffuse.clamp(0.02, 0.98)), roughness, logit(specular.clamp(0.02, 0.98)) + 2], 1)
