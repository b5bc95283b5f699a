"""Non-stationary svBRDFs from several flash photographs of one place: the application and its random photographs.

A batch holds the photographs as `photos` [T, N, 3, H, W], linear, and the measured positions of camera and flash of
each as `places` [T, N, 2, 3], in half sides of the patch. A photograph without a place is one from straight above.
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
from metapp.appearance.flash import Maps, camera_distance, camera_position, render_maps, texel_positions, unpack_maps
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.maps import (
    CHANNELS,
    CLIPPED_VALUE,
    FLASH_LOG_GAIN,
    FLASH_LOG_HEIGHT,
    FLASH_NUMBERS,
    FLASH_SHIFT,
    Flash,
    decode_maps,
    decode_photo,
    encode_roughness,
    map_differences,
    pool_maps,
)
from metapp.apps.svbrdf_nonstationary.places import held_places
from metapp.apps.svbrdf_nonstationary.several import encoder as reader
from metapp.apps.svbrdf_nonstationary.several.height import align_to_surface
from metapp.apps.svbrdf_nonstationary.variants import draws_per_material, vary_materials
from metapp.learning.rules import append_axes
from metapp.learning.task import Batch, Params, Task, Tasks

LIGHT_FLOOR = 0.03  # radiance, 1 is white, that is added before logs
# Initial learned parameters of the loss: where |d| is rounded off, the weights of the prior and of moved flashes
ROUNDING, PRIOR_WEIGHT, FLASH_WEIGHT = 0.02, 0.04, 0.02
LIKELIHOOD_WEIGHT = 0.05  # of the likelihood of predicted deviations, in the outer loss
INITIAL_ROUGHNESSES = (0.15, 0.25, 0.35, 0.5, 0.7)  # candidates for the roughness that Overfit begins with
SEARCH_PX = 64  # a side of the photographs that these candidates are compared on
TILTED_SHARE = 0.6  # of augmented materials, photographed by hand from all sides; the others from above
EXPOSED_SHARE, EXPOSURE_STOPS = 0.3, 0.35  # of augmented materials, each photograph of which is exposed by itself
MAX_TILT_RAD = math.radians(36)


class Texels(NamedTuple):
    """Maps that are parameters themselves, nine unbounded numbers a texel.

    Attributes:
        height, width: texels.
        periodic: whether the maps tile; no photographs of one place do.
    """

    height: int
    width: int
    periodic: bool = False

    def init(self, rng: Generator, count: int) -> Params:
        """Return the numbers of flat grey maps, `maps` [count, 9, height, width]."""
        return {"maps": torch.zeros(count, sum(CHANNELS), self.height, self.width, device=rng.device)}


@dataclass(frozen=True)
class SeveralPhotos(SvbrdfNonstationary):
    """Fits of several flash photographs of one place.

    The parameters are the maps themselves, `maps` [T, 9, H, W] unbounded numbers, and the flashes, `flash`
    [T, FLASH_NUMBERS, N]. Fits that begin at General's maps keep these as a prior: `prior` [T, 18, H, W] has its
    numbers, and the logs of the scales by which they may be off.
    """

    network: Texels = field(default=Texels(256, 256))
    protocol: str = field(default="photo", kw_only=True)
    sees_others = True

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Add all photographs, moved onto the surface, as `photos` [N, 3, H, W], and their `places` [N, 2, 3].

        Raises:
            ValueError: the numbers of places and photographs differ.
        """
        photos = torch.stack([task.data["photo"], *task.data.get("others", ())])
        places = task.data.get("places", camera_position().expand(1, 2, 3)).float()
        if len(places) != len(photos):
            raise ValueError(
                f"{task.name}: {len(photos)} photos and {len(task.data.get('places', ()))} places, expected as many; "
                "convert it again."
            )
        small = adaptive_avg_pool2d(decode_photo(photos), (self.network.height, self.network.width))
        return super().prepare(task) | {"photos": align_to_surface(small, places), "places": places}

    def task_parameters(self, tasks: Tasks) -> Params:
        """Return initial maps and flashes by photometric stereo in closed form.

        One roughness holds for the whole surface: of INITIAL_ROUGHNESSES the one with the lowest loss.
        """
        batch, network = self.condition(tasks, Generator()), self.network
        size = (min(SEARCH_PX, network.height), min(SEARCH_PX, network.width))
        batch["photos"] = _pool_photos(batch["photos"], size)
        slopes, diffuse, rough, specular = reader.read_photos(**batch).maps.split(CHANNELS, 1)
        thetas, losses = [], []
        for roughness in INITIAL_ROUGHNESSES:
            level = torch.full_like(rough, math.log((roughness - 0.05) / (1 - roughness)))
            maps = torch.cat([slopes, diffuse, level, specular], 1)
            thetas.append({"maps": maps, "flash": estimate_flashes(decode_maps(maps), batch)})
            losses.append(self.loss(thetas[-1], batch, {}))
        best = torch.stack(losses).argmin(0), torch.arange(len(tasks), device=tasks.rows.device)
        theta = {key: torch.stack([each[key] for each in thetas])[best] for key in thetas[0]}
        return theta | {"maps": interpolate(theta["maps"], (network.height, network.width), mode="bilinear")}

    def maps_of(self, theta: Params, photo: Tensor) -> Maps:
        """Return the maps at the resolution of a photograph, whose finer detail goes to the diffuse colour."""
        size = photo.shape[-2:]
        if size == theta["maps"].shape[-2:]:
            return decode_maps(theta["maps"])
        maps, logs = decode_maps(interpolate(theta["maps"], size, mode="bicubic")), _logs(photo)
        coarse = adaptive_avg_pool2d(logs, (self.network.height, self.network.width))
        detail = logs - interpolate(coarse, size, mode="bicubic")
        return maps._replace(diffuse=(maps.diffuse * detail.exp()).clamp(0, 1))

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Return the negative log posterior of each task, [T], summed over texels.

        Its terms are rounded |differences| of log photographs and log renderings, where a photograph clips of darker
        renderings alone, squared displacements of flashes, and the distance from the prior where a task has one.
        """
        learned = self.settings(learned, theta["maps"])
        photos = batch["photos"]
        short = _logs(photos) - _logs(
            render_photos(decode_maps(theta["maps"]), decode_flashes(theta["flash"], batch["places"]))
        )
        short = torch.where(photos > CLIPPED_VALUE, relu(short), short)
        loss = _round_off(short, learned["smoothing"].exp()).mean((1, 2, 3, 4))
        loss = loss + learned["flash"].exp() * theta["flash"][:, :3].square().mean((1, 2))
        if "prior" in theta:
            mean, deviation = theta["prior"].detach().chunk(2, 1)
            off = _round_off((theta["maps"] - mean) * (-deviation).exp(), photos.new_ones(())).mean((2, 3))
            loss = loss + (off * learned["prior"].exp()).sum(1) / photos.shape[1]
        return loss * (photos.shape[-2] * photos.shape[-1])

    def settings(self, learned: Params, like: Tensor) -> Params:
        """Return the learned parameters of the loss, [T, ...], or their initial values if there are none.

        Args:
            learned: the parameters that a rule has learned, or {}.
            like: a tensor whose first axis is of tasks, and whose dtype and device count.
        """
        return learned or {
            key: value.expand(len(like), *value.shape[1:]).to(like) for key, value in self.loss_parameters(1).items()
        }

    def loss_parameters(self, steps: int) -> Params:
        """Return logs of initial values.

        They are of the rounding of |d|, of the weight of the prior for each of the nine numbers of a texel, and of the
        weight of moved flashes.
        """
        values = {
            "smoothing": torch.tensor(ROUNDING),
            "prior": torch.full((sum(CHANNELS),), PRIOR_WEIGHT),
            "flash": torch.tensor(FLASH_WEIGHT),
        }
        return {key: value.log().expand(steps, *value.shape).clone() for key, value in values.items()}

    def outer_loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Return how far maps, above all normals, their log radiance under random lights and the prior are off, [T].

        The prior's deviations count by the likelihood of General's errors, and nothing else moves them.
        """
        maps, target = decode_maps(theta["maps"]), unpack_maps(batch["maps"])
        logs, references = (self.log_radiance(each, batch["pairs"]) for each in (maps, target))
        diffuse, specular, roughness, normal = (each.abs().mean((1, 2, 3)) for each in map_differences(maps, target))
        slopes = (_slopes_of(maps.normal) - _slopes_of(target.normal)).abs().mean((1, 2, 3))
        tilted = target.normal[:, :2].abs().sum(1).mean((1, 2)) / 3
        loss = 0.5 * (logs - references).abs().mean((1, 2, 3, 4)) + 2 * normal + 0.15 * normal / (tilted + 0.03)
        loss = loss + 0.5 * slopes + 0.7 * diffuse + 0.5 * specular + roughness
        mean, deviation = theta["prior"].chunk(2, 1)
        off = (mean - _encode_maps(target)).detach().abs() * (-deviation).exp() + deviation
        return loss + LIKELIHOOD_WEIGHT * off.mean((1, 2, 3))

    def init_encoder(self, rng: Generator) -> Params:
        """Return random parameters of the network that corrects photometric stereo."""
        return reader.init(rng)

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        """Return all photographs and their places."""
        return {key: tasks.data[key][tasks.rows] for key in ("photos", "places")}

    def encode(self, encoder: Params, condition: Batch) -> Params:
        """Return General's maps, also as the prior, and flashes whose brightness agrees with them."""
        maps, deviation = reader.predict_maps(encoder, reader.read_photos(**condition))
        wide = [part.expand(-1, count, -1, -1) for part, count in zip(deviation.split(1, 1), CHANNELS, strict=True)]
        return {
            "maps": maps,
            "flash": estimate_flashes(decode_maps(maps), condition),
            "prior": torch.cat([maps, *wide], 1),
        }

    def postprocess(self, theta: Params) -> Params:
        """Return maps and flashes; the prior is not kept."""
        return {key: value for key, value in theta.items() if key != "prior"}

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Turn, mirror, mix and recolour the materials, and take several photographs of each."""
        size = (self.network.height, self.network.width)
        fine = vary_materials(tasks.data["fine"][tasks.rows].float(), self.shot_size, rng)
        photos, places = draw_photo_sets(fine, tasks.data["places"].shape[1], rng)
        small = _pool_photos(photos, size)
        return tasks.make_variants(
            {"photo": small[:, 0], "photos": small, "places": places} | self.describe_maps(pool_maps(fine, size))
        )

    @override
    def flashes(self, theta: Params, task: Task) -> list[Flash]:
        places = task.data.get("places", camera_position().expand(1, 2, 3))[None].float()
        flash = decode_flashes(theta["flash"][None], places)
        return [Flash(*(part[0, number] for part in flash)) for number in range(places.shape[1])]


def decode_flashes(flash: Tensor, places: Tensor) -> Flash:
    """Return the flashes that unbounded numbers stand for, with axes [T, N, ...].

    Zeros stand for a flash at its measured place in whose light a white patch has radiance 1 right below it. People
    hold camera and flash together, so that both move.

    Args:
        flash: the numbers, [T, FLASH_NUMBERS, N].
        places: measured positions of camera and flash, [T, N, 2, 3], in half sides of the patch.
    """
    aside, higher, brighter = flash.mT.split((2, 1, 1), -1)
    higher = torch.exp(FLASH_LOG_HEIGHT * higher)
    eye, place = torch.cat(
        [places[..., :2] + FLASH_SHIFT * aside[:, :, None], places[..., 2:] * higher[:, :, None]], -1
    ).unbind(2)
    return Flash(place, torch.exp(FLASH_LOG_GAIN * brighter) * (place[..., 2:] / camera_distance()) ** 2, eye)


def render_photos(maps: Maps, flashes: Flash) -> Tensor:
    """Return the radiance [T, N, 3, H, W] of maps [T, C, H, W] under each of N flashes."""
    like = maps.diffuse
    place = texel_positions(*like.shape[-2:], dtype=like.dtype, device=like.device)
    each = Maps(*(part[:, None] for part in maps))
    return render_maps(each, place, flashes.place, flashes.eye, intensity=flashes.gain)


@torch.no_grad()
def estimate_flashes(maps: Maps, batch: Batch) -> Tensor:
    """Return numbers of flashes at their measured places, as bright as maps ask for, [T, FLASH_NUMBERS, N].

    Args:
        maps: the maps [T, C, H, W].
        batch: `photos` and `places`; the median over texels counts, where nothing clips.
    """
    places, photos = batch["places"], batch["photos"]
    none = places.new_zeros(len(places), FLASH_NUMBERS, places.shape[1])
    off = _logs(photos) - _logs(render_photos(maps, decode_flashes(none, places)))
    off = torch.where(photos > CLIPPED_VALUE, 0, off).mean(2).flatten(2).median(2).values
    return torch.cat([none[:, :-1], off[:, None] / FLASH_LOG_GAIN], 1)


def draw_photo_sets(maps: Tensor, count: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Take random photographs of materials, as people do by hand.

    The camera is held over the patch or tilted from all sides; measured places are up to 3 % off; the exposure is one
    for all photographs, or each time another.

    Args:
        maps: packed maps [T, 10, S, S].
        count: photographs of each material.
        rng: of all draws.

    Returns:
        Linear photographs of 8 bits, [T, count, 3, S, S], and measured places [T, count, 2, 3].
    """
    uniform, normal = draws_per_material(len(maps), rng)
    held, off = held_places(len(maps), count, rng)
    turn = 2 * math.pi * (torch.arange(count, device=rng.device)[None, :, None] / max(count - 1, 1) + uniform(1, 1))
    turn, tilt = turn + 0.4 * normal(count, 1), 0.1 + (MAX_TILT_RAD - 0.1) * uniform(count, 1)
    tilt = torch.cat([0.15 * tilt[:, :1], tilt[:, 1:]], 1)  # the first from about straight above
    far = camera_distance() * (0.75 + 0.5 * uniform(count, 1)) * (1 + uniform(1, 1))
    tilted = far * torch.cat([tilt.sin() * turn.cos(), tilt.sin() * turn.sin(), tilt.cos()], -1)
    true = torch.where(uniform(1, 1) < TILTED_SHARE, tilted, held)
    measured = true + 1.5 * uniform(1, 1) * off
    level = torch.where(uniform(1) < EXPOSED_SHARE, EXPOSURE_STOPS * normal(count) - 0.15, 0.06 * normal(count))
    flash = torch.cat([level.new_zeros(len(maps), FLASH_NUMBERS - 1, count), level[:, None] / FLASH_LOG_GAIN], 1)
    both = true[:, :, None].expand(-1, -1, 2, -1)
    display = linear_to_srgb(render_photos(unpack_maps(maps), decode_flashes(flash, both)).clamp(0, 1))
    display = display + 0.01 * uniform(1, 1, 1, 1) * torch.randn(display.shape, generator=rng, device=rng.device)
    photos = srgb_to_linear((display.clamp(0, 1) * 255).round() / 255)
    return photos, measured[:, :, None].expand(-1, -1, 2, -1)


def _pool_photos(photos: Tensor, size: tuple[int, int]) -> Tensor:
    small: Tensor = adaptive_avg_pool2d(photos.flatten(0, 1), size).unflatten(0, photos.shape[:2])
    return small


def _logs(radiance: Tensor) -> Tensor:
    return (radiance + LIGHT_FLOOR).log()


def _round_off(difference: Tensor, s: Tensor) -> Tensor:
    """Return sqrt(d^2 + s^2) - s for a difference d [T, ...] and s [T] or a number: |d|, rounded off below s."""
    s = append_axes(s, difference)
    return (difference * difference + s * s).sqrt() - s


def _slopes_of(normal: Tensor) -> Tensor:
    return normal[:, :2] / normal[:, 2:].clamp_min(0.2)


def _encode_maps(maps: Maps) -> Tensor:
    """Return the unbounded numbers [T, 9, H, W] of maps, the inverse of `decode_maps` but at the ends of ranges."""
    logit = torch.logit
    diffuse, specular = (maps.diffuse.clamp(1e-4, 1) ** (1 / 2.2), maps.specular.clamp(1e-4, 1).sqrt())
    slopes = maps.normal[:, :2] / maps.normal[:, 2:].clamp_min(0.1)
    roughness = encode_roughness(maps.roughness)
    return torch.cat([slopes, logit(diffuse.clamp(0.02, 0.98)), roughness, logit(specular.clamp(0.02, 0.98)) + 2], 1)
