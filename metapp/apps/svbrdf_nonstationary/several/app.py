"""Non-stationary svBRDFs from several flash photographs of one place: the application and its random photographs.

A batch holds N linear photographs of each task, `photos` [T, N, 3, H, W], and the measured positions of camera and
flash of each photograph, `places` [T, N, 2, 3], in half sides of the patch. A task that has a single photograph and no
places was photographed from straight above.
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
    CLIPPED_LINEAR_VALUE,
    FLASH_LOG_GAIN,
    FLASH_LOG_HEIGHT,
    FLASH_NUMBERS,
    FLASH_SHIFT,
    MIN_ROUGHNESS,
    Flash,
    decode_maps,
    decode_photo,
    encode_roughness,
    find_slopes,
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
# Initial values of the loss parameters that a rule may learn
ROUNDING = 0.02  # log radiance: |differences| of photographs and renderings are rounded off below
PRIOR_WEIGHT = 0.04  # weight of the distance from the prior, for each number of a texel
FLASH_WEIGHT = 0.02  # weight of the squared displacements of flashes from their measured positions
LIKELIHOOD_WEIGHT = 0.05  # weight in the outer loss of the likelihood of the scales that General predicts
INITIAL_ROUGHNESSES = (0.15, 0.25, 0.35, 0.5, 0.7)  # candidates for the roughness that Overfit begins with
SEARCH_PX = 64  # side of the photographs by which these candidates are compared
TILTED_SHARE = 0.6  # share of augmented materials that are photographed from all sides; the others from above
UNEQUAL_EXPOSURE_SHARE = 0.3  # share of augmented materials whose photographs differ in exposure
EXPOSURE_LOG_DEVIATION = 0.35  # standard deviation of the natural log of exposures that differ
MAX_TILT_RAD = math.radians(36)  # largest angle of a camera with the patch's normal


class Texels(NamedTuple):
    """The network of fits whose parameters are the maps themselves: nine unbounded numbers for each texel.

    Attributes:
        height, width: the size of the maps in texels.
        periodic: whether the maps tile; False, since the maps of a photographed place do not.
    """

    height: int
    width: int
    periodic: bool = False

    def init(self, rng: Generator, count: int) -> Params:
        """Return the numbers of flat grey maps, `maps` [count, 9, height, width]."""
        return {"maps": torch.zeros(count, sum(CHANNELS), self.height, self.width, device=rng.device)}


@dataclass(frozen=True)
class SeveralPhotos(SvbrdfNonstationary):
    """The application whose fits see several flash photographs of one place.

    The parameters of a fit are unbounded numbers: `maps` [T, 9, H, W] stands for the maps, `flash`
    [T, FLASH_NUMBERS, N] for the flashes. A fit that begins at General's maps is kept near them by a third parameter,
    `prior` [T, 18, H, W], which no step changes: at each texel the nine numbers that the prior expects, then the logs
    of the nine scales by which they may be off.
    """

    network: Texels = field(default=Texels(256, 256))
    protocol: str = field(default="photo", kw_only=True)
    sees_others = True

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Add all photographs and their places.

        Returns:
            Also `photos` [N, 3, H, W], linear photographs aligned to the height of the surface, see
            :func:`align_to_surface`, and `places` [N, 2, 3].

        Raises:
            ValueError: the numbers of places and photographs differ.
        """
        photos = torch.stack([task.data["photo"], *task.data.get("others", ())])
        places = _task_places(task)
        if len(places) != len(photos):
            raise ValueError(
                f"{task.name}: {len(photos)} photos and {len(task.data.get('places', ()))} places, expected as many; "
                "convert it again."
            )
        small = adaptive_avg_pool2d(decode_photo(photos), (self.network.height, self.network.width))
        return super().prepare(task) | {"photos": align_to_surface(small, places), "places": places}

    @override
    def task_parameters(self, tasks: Tasks) -> Params:
        """Return initial maps and flashes, by photometric stereo in closed form.

        The whole surface gets one roughness, by which stereo does not solve: of INITIAL_ROUGHNESSES the one with the
        lowest loss.
        """
        batch, network = self.condition(tasks, Generator()), self.network
        size = (min(SEARCH_PX, network.height), min(SEARCH_PX, network.width))
        batch["photos"] = _pool_photos(batch["photos"], size)
        slopes, diffuse, roughness_numbers, specular = reader.read_photos(**batch).maps.split(CHANNELS, 1)
        candidates, losses = [], []
        for roughness in INITIAL_ROUGHNESSES:
            number = math.log((roughness - MIN_ROUGHNESS) / (1 - roughness))
            maps = torch.cat([slopes, diffuse, torch.full_like(roughness_numbers, number), specular], 1)
            candidates.append({"maps": maps, "flash": estimate_flashes(decode_maps(maps), batch)})
            losses.append(self.loss(candidates[-1], batch, {}))
        best = torch.stack(losses).argmin(0), torch.arange(len(tasks), device=tasks.rows.device)
        theta = {key: torch.stack([candidate[key] for candidate in candidates])[best] for key in candidates[0]}
        return theta | {"maps": interpolate(theta["maps"], (network.height, network.width), mode="bilinear")}

    @override
    def maps_of(self, theta: Params, photo: Tensor) -> Maps:
        """Return the maps at the size of a photograph.

        Enlarged maps are smooth: the detail of the photograph that is finer than the fitted maps is multiplied onto the
        diffuse colour.
        """
        size = photo.shape[-2:]
        if size == theta["maps"].shape[-2:]:
            return decode_maps(theta["maps"])
        maps, logs = decode_maps(interpolate(theta["maps"], size, mode="bicubic")), _log_radiance(photo)
        coarse_logs = adaptive_avg_pool2d(logs, (self.network.height, self.network.width))
        log_detail = logs - interpolate(coarse_logs, size, mode="bicubic")
        return maps._replace(diffuse=(maps.diffuse * log_detail.exp()).clamp(0, 1))

    @override
    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Return the negative log posterior of each task, [T], summed over texels.

        It has three terms: rounded |differences| of log photographs and log renderings; squared displacements of the
        flashes; and, where a task has a prior, rounded |distances| of the maps from it. Where a photograph clips, only
        darker renderings differ from it.
        """
        parameters = self.settings(learned, theta["maps"])
        photos = batch["photos"]
        residual = _log_radiance(photos) - _log_radiance(
            render_photos(decode_maps(theta["maps"]), decode_flashes(theta["flash"], batch["places"]))
        )
        residual = torch.where(photos > CLIPPED_LINEAR_VALUE, relu(residual), residual)
        loss = _round_off(residual, parameters["smoothing"].exp()).mean((1, 2, 3, 4))
        # The gain of a flash, its last number, is free.
        loss = loss + parameters["flash"].exp() * theta["flash"][:, :-1].square().mean((1, 2))
        if "prior" in theta:
            mean, log_scale = theta["prior"].detach().chunk(2, 1)
            distances = _round_off((theta["maps"] - mean) * (-log_scale).exp(), photos.new_ones(())).mean((2, 3))
            # The more photographs there are, the less the prior counts beside their mean.
            loss = loss + (distances * parameters["prior"].exp()).sum(1) / photos.shape[1]
        return loss * (photos.shape[-2] * photos.shape[-1])

    def settings(self, learned: Params, like: Tensor) -> Params:
        """Return the loss parameters [T, ...]: those that a rule has learned, or their initial values.

        Args:
            learned: the loss parameters that a rule has learned; {} for none.
            like: a tensor [T, ...] that gives initial values their number of tasks, dtype and device.
        """
        return learned or {
            key: value.expand(len(like), *value.shape[1:]).to(like) for key, value in self.loss_parameters(1).items()
        }

    @override
    def loss_parameters(self, steps: int) -> Params:
        """Return the logs of initial values of the loss parameters.

        Returns:
            `smoothing` [steps], the log of ROUNDING; `prior` [steps, 9], the log of PRIOR_WEIGHT for each number of a
            texel; `flash` [steps], the log of FLASH_WEIGHT.
        """
        values = {
            "smoothing": torch.tensor(ROUNDING),
            "prior": torch.full((sum(CHANNELS),), PRIOR_WEIGHT),
            "flash": torch.tensor(FLASH_WEIGHT),
        }
        return {key: value.log().expand(steps, *value.shape).clone() for key, value in values.items()}

    @override
    def outer_loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Return the difference of maps, above all normals, and of their log radiance under random lights, [T].

        A last term trains the scales of General's prior: the negative log likelihood of the errors of its maps under
        Laplace distributions of these scales.
        """
        maps, target = decode_maps(theta["maps"]), unpack_maps(batch["maps"])
        differences = map_differences(maps, target)
        diffuse, specular, roughness, normal = (difference.abs().mean((1, 2, 3)) for difference in differences)
        slope_error = (find_slopes(maps.normal) - find_slopes(target.normal)).abs().mean((1, 2, 3))
        mean_tilt = target.normal[:, :2].abs().sum(1).mean((1, 2)) / 3
        loss = 0.5 * self.radiance_difference(maps, target, batch["pairs"])
        loss = loss + 2 * normal + 0.15 * normal / (mean_tilt + 0.03)
        loss = loss + 0.5 * slope_error + 0.7 * diffuse + 0.5 * specular + roughness
        mean, log_scale = theta["prior"].chunk(2, 1)
        negative_log_likelihood = (mean - _encode_maps(target)).detach().abs() * (-log_scale).exp() + log_scale
        return loss + LIKELIHOOD_WEIGHT * negative_log_likelihood.mean((1, 2, 3))

    @override
    def init_encoder(self, rng: Generator) -> Params:
        """Draw random parameters of the network that corrects photometric stereo."""
        return reader.init(rng)

    @override
    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        """Return all photographs and their places."""
        return {key: tasks.data[key][tasks.rows] for key in ("photos", "places")}

    @override
    def encode(self, encoder: Params, condition: Batch) -> Params:
        """Return General's maps, the flashes whose brightness agrees with them, and these maps as the prior."""
        maps, log_scales = reader.predict_maps(encoder, reader.read_photos(**condition))
        # General predicts one scale for each kind of map: all numbers of that kind share it.
        expanded_scales = [
            log_scale.expand(-1, count, -1, -1)
            for log_scale, count in zip(log_scales.split(1, 1), CHANNELS, strict=True)
        ]
        return {
            "maps": maps,
            "flash": estimate_flashes(decode_maps(maps), condition),
            "prior": torch.cat([maps, *expanded_scales], 1),
        }

    @override
    def postprocess(self, theta: Params) -> Params:
        """Return maps and flashes; the prior is not kept."""
        return {key: value for key, value in theta.items() if key != "prior"}

    @override
    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Vary the materials, and take several photographs of each."""
        size = (self.network.height, self.network.width)
        fine = vary_materials(tasks.data["fine"][tasks.rows].float(), self.shot_size, rng)
        photos, places = draw_photo_sets(fine, tasks.data["places"].shape[1], rng)
        small = _pool_photos(photos, size)
        return tasks.make_variants(
            {"photo": small[:, 0], "photos": small, "places": places} | self.describe_maps(pool_maps(fine, size))
        )

    @override
    def flashes(self, theta: Params, task: Task) -> list[Flash]:
        places = _task_places(task)[None]
        flash = decode_flashes(theta["flash"][None], places)
        return [Flash(*(part[0, number] for part in flash)) for number in range(places.shape[1])]


def decode_flashes(flash: Tensor, places: Tensor) -> Flash:
    """Return the flashes that unbounded numbers stand for, with axes [T, N, ...].

    Zeros stand for a flash at its measured position, in whose light a white patch right below it has radiance 1. In a
    hand-held device the flash sits beside the lens: the shift and the height that the numbers state move both.

    Args:
        flash: the numbers, [T, FLASH_NUMBERS, N].
        places: measured positions of camera and flash, [T, N, 2, 3], in half sides of the patch.
    """
    shift, height_factor, gain = flash.mT.split((2, 1, 1), -1)
    height_factor = torch.exp(FLASH_LOG_HEIGHT * height_factor)
    eye, place = torch.cat(
        [places[..., :2] + FLASH_SHIFT * shift[:, :, None], places[..., 2:] * height_factor[:, :, None]], -1
    ).unbind(2)
    return Flash(place, torch.exp(FLASH_LOG_GAIN * gain) * (place[..., 2:] / camera_distance()) ** 2, eye)


def render_photos(maps: Maps, flashes: Flash) -> Tensor:
    """Return the radiance [T, N, 3, H, W] of maps [T, C, H, W] under each of N flashes."""
    diffuse = maps.diffuse
    place = texel_positions(*diffuse.shape[-2:], dtype=diffuse.dtype, device=diffuse.device)
    photographed_maps = Maps(*(part[:, None] for part in maps))
    return render_maps(photographed_maps, place, flashes.place, flashes.eye, intensity=flashes.gain)


@torch.no_grad()
def estimate_flashes(maps: Maps, batch: Batch) -> Tensor:
    """Return the numbers of flashes at their measured positions whose gains fit the photographs, [T, FLASH_NUMBERS, N].

    The log gain of a flash is the median over texels of the difference of the log photograph from the log rendering of
    the maps, where clipped values count as no difference.

    Args:
        maps: the maps [T, C, H, W].
        batch: `photos` and `places`.
    """
    places, photos = batch["places"], batch["photos"]
    zeros = places.new_zeros(len(places), FLASH_NUMBERS, places.shape[1])
    log_gains = _log_radiance(photos) - _log_radiance(render_photos(maps, decode_flashes(zeros, places)))
    log_gains = torch.where(photos > CLIPPED_LINEAR_VALUE, 0, log_gains).mean(2).flatten(2).median(2).values
    return torch.cat([zeros[:, :-1], log_gains[:, None] / FLASH_LOG_GAIN], 1)


def draw_photo_sets(maps: Tensor, count: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Render random photographs of materials, as people take them by hand.

    The camera is held over the patch, or is moved around it and tilted towards it. Measured places have Gaussian errors
    of up to 3 % of the camera's height. The exposures of a material nearly agree, or differ for a share of
    UNEQUAL_EXPOSURE_SHARE.

    Args:
        maps: packed maps [T, 10, S, S].
        count: photographs of each material.
        rng: draws all random numbers.

    Returns:
        Photographs [T, count, 3, S, S], linear values that were rounded to 8 bits of sRGB, and measured places
        [T, count, 2, 3].
    """
    uniform, normal = draws_per_material(len(maps), rng)
    places_above, offsets = held_places(len(maps), count, rng)
    azimuth = 2 * math.pi * (torch.arange(count, device=rng.device)[None, :, None] / max(count - 1, 1) + uniform(1, 1))
    azimuth, tilt = azimuth + 0.4 * normal(count, 1), 0.1 + (MAX_TILT_RAD - 0.1) * uniform(count, 1)
    tilt = torch.cat([0.15 * tilt[:, :1], tilt[:, 1:]], 1)  # the first photograph is taken from nearly straight above
    distance = camera_distance() * (0.75 + 0.5 * uniform(count, 1)) * (1 + uniform(1, 1))
    tilted_places = distance * torch.cat([tilt.sin() * azimuth.cos(), tilt.sin() * azimuth.sin(), tilt.cos()], -1)
    true_places = torch.where(uniform(1, 1) < TILTED_SHARE, tilted_places, places_above)
    measured_places = true_places + 1.5 * uniform(1, 1) * offsets
    log_exposure = torch.where(
        uniform(1) < UNEQUAL_EXPOSURE_SHARE, EXPOSURE_LOG_DEVIATION * normal(count) - 0.15, 0.06 * normal(count)
    )
    flash = torch.cat(
        [log_exposure.new_zeros(len(maps), FLASH_NUMBERS - 1, count), log_exposure[:, None] / FLASH_LOG_GAIN], 1
    )
    positions = true_places[:, :, None].expand(-1, -1, 2, -1)
    display = linear_to_srgb(render_photos(unpack_maps(maps), decode_flashes(flash, positions)).clamp(0, 1))
    display = display + 0.01 * uniform(1, 1, 1, 1) * torch.randn(display.shape, generator=rng, device=rng.device)
    photos = srgb_to_linear((display.clamp(0, 1) * 255).round() / 255)
    return photos, measured_places[:, :, None].expand(-1, -1, 2, -1)


def _task_places(task: Task) -> Tensor:
    """Return the positions of camera and flash, [N, 2, 3]; a task without places has one photo from straight above."""
    return task.data.get("places", camera_position().expand(1, 2, 3)).float()


def _pool_photos(photos: Tensor, size: tuple[int, int]) -> Tensor:
    """Average photographs [T, N, 3, H, W] over areas to another size."""
    pooled: Tensor = adaptive_avg_pool2d(photos.flatten(0, 1), size).unflatten(0, photos.shape[:2])
    return pooled


def _log_radiance(radiance: Tensor) -> Tensor:
    """Return the logs of radiance plus LIGHT_FLOOR."""
    return (radiance + LIGHT_FLOOR).log()


def _round_off(difference: Tensor, rounding: Tensor) -> Tensor:
    """Return sqrt(d^2 + s^2) - s for a difference d [T, ...] and its rounding s [T] or []: |d|, rounded off below s."""
    rounding = append_axes(rounding, difference)
    return (difference * difference + rounding * rounding).sqrt() - rounding


def _encode_maps(maps: Maps) -> Tensor:
    """Return the unbounded numbers [T, 9, H, W] of maps: the inverse of `decode_maps` except at the ends of ranges."""
    logit = torch.logit
    diffuse, specular = (maps.diffuse.clamp(1e-4, 1) ** (1 / 2.2), maps.specular.clamp(1e-4, 1).sqrt())
    slopes = maps.normal[:, :2] / maps.normal[:, 2:].clamp_min(0.1)
    roughness = encode_roughness(maps.roughness)
    return torch.cat([slopes, logit(diffuse.clamp(0.02, 0.98)), roughness, logit(specular.clamp(0.02, 0.98)) + 2], 1)
