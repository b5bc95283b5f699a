"""Fits whose maps a small network makes of the photograph and of a code in each place.

`FromMaps` sees the material itself, `FromPhoto` one photograph of it alone; both are fits of one network, and General's
encoder reads one photograph for both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, relu
from typing_extensions import override

from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.flash_rendering import camera_distance
from metapp.appearance.highlight import FILL_PX, fill_clipped
from metapp.appearance.svbrdf_maps import Maps, tilt_sine, unpack_maps
from metapp.apps.svbrdf_nonstationary.app import (
    FINEST_PX,
    LEVEL_SINE,
    RADIANCE_FLOOR,
    SvbrdfNonstationary,
    blots,
    fixed_pairs,
)
from metapp.apps.svbrdf_nonstationary.encoder import Encoder
from metapp.apps.svbrdf_nonstationary.flashes import FLASH_LOG_HEIGHT, Flash, decode_flash, render_photo
from metapp.apps.svbrdf_nonstationary.maps import (
    CHANNELS,
    CLIPPED_LINEAR_VALUE,
    PIXEL_INPUTS,
    decode_maps,
    map_differences,
    pixel_inputs,
    pool_maps,
)
from metapp.apps.svbrdf_nonstationary.variants import draw_photos, vary_materials
from metapp.learning.task import Batch, Params, Task, Tasks
from metapp.networks.coded import CodedApp, smooth_absolute
from metapp.networks.field import LocalField, evaluate_by_rows

MAPS_WEIGHT, PHOTO_WEIGHT = 0.3, 0.3  # weights in the outer loss, beside 1 for pictures under other lights
STEEPNESS_WEIGHT = 0.2  # weight in the outer loss of the mean steepness of normals, which a photo hardly shows
BLOTS_WEIGHT = 0.3  # weight in the outer loss of diffuse colours where the photo clips
STEEPNESS_CELLS = 8  # cells a side, in each of which the mean steepness of normals counts
FITTED_LIGHTS = (2, 3)  # lights that fits of the maps see the material under: anywhere above the patch, mirrored in it
USUAL_LOG_HEIGHT = 0.05  # deviation of the log of a camera's height below which it is at `camera_distance`
SMOOTHING = 0.03  # initial learned rounding of |d| in losses


def field_of(side: int, hidden: int) -> LocalField:
    """Return the network of maps of side x side texels, with so many hidden units."""
    return LocalField(
        side,
        side,
        inputs=PIXEL_INPUTS,
        outputs=sum(CHANNELS),
        rows=side,  # a cell for each texel, so that a step moves texels independently
        columns=side,
        code=12,
        hidden=hidden,
        layers=2,
        frequency=2.0,
        periodic=False,
        gain=60.0,
    )


@dataclass(frozen=True)
class CodedMaps(SvbrdfNonstationary, CodedApp):
    """Non-stationary svBRDFs whose maps a field makes of the photograph and of the code at each place.

    Attributes:
        encoder_width: the number of channels of the encoder's level of 64 texels.
        encoder_size: the side of the photograph that the encoder reads; 0 for the side of the network's maps.
        encoder_finer: the numbers of channels of the encoder's levels above 64 texels, the coarsest first.
    """

    encoder_width: int = 16
    encoder_size: int = 0
    encoder_finer: tuple[int, ...] = ()

    @property
    def encoder(self) -> Encoder:
        """The reader of photographs."""
        return Encoder(self.encoder_width, self.network.code, self.encoder_finer)

    @property
    @override
    def read_size(self) -> int:
        return FINEST_PX if self.encoder_size or self.encoder_finer else 0

    @override
    def maps_of(self, theta: Params, photo: Tensor) -> Maps:
        height, width = photo.shape[-2:]
        return self.maps_from(self.network._replace(height=height, width=width)(theta, pixel_inputs(photo)))

    @override
    def fine_maps(self, theta: Params, photo: Tensor) -> Maps:
        """Make the maps by rows: a layer of a field of 2048 x 2048 texels takes 0.5 GB."""
        field_of_photo = self.network._replace(height=photo.shape[-2], width=photo.shape[-1])
        strips = [self.maps_from(rows) for rows in evaluate_by_rows(field_of_photo, theta, pixel_inputs(photo))]
        return Maps(*(torch.cat(strip_maps, -2) for strip_maps in zip(*strips, strict=True)))

    def maps_from(self, raw: Tensor) -> Maps:
        """Return the maps [T, C, h, w] that outputs of fields, [T, sum(CHANNELS), h, w], stand for."""
        return decode_maps(raw)

    @override
    def flashes(self, theta: Params, task: Task) -> list[Flash]:
        return [self.flash_of(theta)]

    def flash_of(self, theta: Params) -> Flash:
        """Return the flashes of fits with parameters [T, ...]."""
        return decode_flash(self.network.gain * theta["flash"])

    @override
    def outer_loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the difference of the maps and of their radiance under any light, whatever fits see, [T].

        The mean steepness of normals counts, too: the normals with the least mean difference from all that a photo
        allows are flat.
        """
        maps, target = self.maps_of(theta, batch["photo"]), unpack_maps(batch["maps"])
        pictures = self.radiance_difference(maps, target, batch["pairs"])
        photo = self.photo_difference(theta, maps, batch, {})
        steepness_difference = (_steepness(maps) / _steepness(target)).log().abs().mean((1, 2, 3))
        differences = map_differences(maps, target)
        # roughness and normals count twice, as photos say less of them
        map_loss = _map_loss(differences, {}) + _map_loss(differences[2:], {})
        loss = pictures + MAPS_WEIGHT * map_loss + PHOTO_WEIGHT * photo + STEEPNESS_WEIGHT * steepness_difference
        return loss + BLOTS_WEIGHT * blots(differences[0], batch["photo"])

    def photo_difference(self, theta: Params, maps: Maps, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the mean difference of the logs of the photograph and of the maps under the fitted flash, [T]."""
        radiance = render_photo(maps, self.flash_of(theta), batch.get("place"))
        return photo_loss(radiance, batch["photo"], loss_parameters)

    @override
    def initial_loss_parameters(self, steps: int) -> Params:
        return {"smoothing": torch.full((steps,), math.log(SMOOTHING))}

    @override
    def init_reader(self, rng: Generator) -> Params:
        return self.encoder.init(rng)

    @override
    def read(self, reader: Params, photos: Tensor) -> Params:
        photos = adaptive_avg_pool2d(photos, self.encoder_size or photos.shape[-1])
        parameters = self.encoder(reader, photos)
        return parameters | {key: parameters[key] / self.network.gain for key in ("z", "flash")}

    @override
    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Turn, mirror, mix and recolour the materials, and photograph them anew."""
        size = (self.network.height, self.network.width)
        fine = vary_materials(tasks.data["fine"][tasks.rows].float(), self.shot_size, rng)
        photo = adaptive_avg_pool2d(draw_photos(fine, rng), size)
        return tasks.make_variants({"photo": photo} | self.describe_maps(pool_maps(fine, size)))


@dataclass(frozen=True)
class FromMaps(CodedMaps):
    """The application whose fits see a material's maps, and pictures of it under some lights (--observe reference)."""

    observes = "reference"

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        if "maps" not in task.data:
            raise ValueError(
                f"{task.name}: a flash photo, expected a material's maps; give these or a strip, or leave --observe "
                "reference out."
            )
        return super().prepare(task)

    @override
    def describe_maps(self, maps: Tensor) -> dict[str, Tensor]:
        """Describe maps by the tensors that losses compare with fits.

        Returns:
            `maps`; `fitted_lights`, the directions of lights and viewers under which fits see the maps, [T, V, 2, 3];
            and `lit`, the log radiance under these.
        """
        pairs = fixed_pairs(FITTED_LIGHTS).to(maps).expand(len(maps), -1, -1, -1)
        return {"maps": maps, "fitted_lights": pairs, "lit": self.log_radiance(unpack_maps(maps), pairs)}

    @override
    def loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the difference of maps plus the difference of log radiance under the lights that fits see, [T]."""
        maps = self.maps_of(theta, batch["photo"])
        log_radiance = self.log_radiance(maps, batch["fitted_lights"])
        log_differences = smooth_absolute(log_radiance - batch["lit"], loss_parameters)
        return log_differences.mean((1, 2, 3, 4)) + _map_loss(
            map_differences(maps, unpack_maps(batch["maps"])), loss_parameters
        )


@dataclass(frozen=True)
class FromPhoto(CodedMaps):
    """The application whose fits see one photograph alone, and estimate its flash, too (--observe photo)."""

    observes = "photo"

    @property
    @override
    def fills(self) -> bool:
        """True for maps of the size that people use."""
        return bool(self.read_size)

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Add the camera's `height` [1] in half sides of the patch, 0 if it is unknown or where fits expect it."""
        places = task.data.get("places", torch.zeros(1, 2, 3)).float()
        height = places[0, 0, 2:]
        is_usual = (height / camera_distance()).log().abs() < USUAL_LOG_HEIGHT
        return super().prepare(task) | ({"height": torch.where(is_usual, 0, height)} if self.fills else {})

    @override
    def encoder_input(self, tasks: Tasks, rng: Generator) -> Batch:
        heights = {"height": tasks.data["height"][tasks.rows]} if "height" in tasks.data else {}
        return super().encoder_input(tasks, rng) | heights

    @override
    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        return self._move_flash(super().encode(encoder, encoder_input), encoder_input)

    @override
    def photo_difference(self, theta: Params, maps: Maps, batch: Batch, loss_parameters: Params) -> Tensor:
        return super().photo_difference(self._move_flash(theta, batch), maps, batch, loss_parameters)

    def _move_flash(self, theta: Params, batch: Batch) -> Params:
        """Return parameters [T, ...] whose flashes are as high as the cameras, where their `height` [T, 1] is known."""
        if "height" not in batch:
            return theta
        x, y, log_height, gain = theta["flash"].split(1, 1)
        known = (batch["height"] / camera_distance()).log() / (FLASH_LOG_HEIGHT * self.network.gain)
        log_height = torch.where(batch["height"] > 0, known, log_height)
        return theta | {"flash": torch.cat([x, y, log_height, gain], 1)}

    @override
    def flash_of(self, theta: Params) -> Flash:
        """Return the flashes of fits with parameters [T, ...]; photographs of the size that people use may be crops."""
        return decode_flash(self.network.gain * theta["flash"], camera="raised" if self.fills else "fixed")

    @override
    def fill(self, theta: Params, maps: Maps, photo: Tensor) -> Maps:
        """Fill maps [T, C, h, w] where linear photographs [T, 3, h, w] clip; see :func:`fill_clipped`.

        Losses see maps before they are filled: a photograph that clips is at least so bright.
        """
        if not self.fills:
            return maps
        small = adaptive_avg_pool2d(photo, min(FILL_PX, *photo.shape[-2:]))
        return fill_clipped(maps, linear_to_srgb(small))

    @override
    def loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        return self.photo_difference(theta, self.maps_of(theta, batch["photo"]), batch, loss_parameters)


def photo_loss(radiance: Tensor, photos: Tensor, loss_parameters: Params, weights: Tensor | float = 1.0) -> Tensor:
    """Return the mean difference of the logs of radiance and photographs, [T]; where these clip, only if it is darker.

    Args:
        radiance: the radiance of maps, [T, ...].
        photos: linear photographs of that shape.
        loss_parameters: the learned parameters of the loss, {} for |d|.
        weights: factors of the differences, [T, 1, ...].
    """
    log_differences = (photos + RADIANCE_FLOOR).log() - (radiance + RADIANCE_FLOOR).log()
    log_differences = torch.where(photos > CLIPPED_LINEAR_VALUE, relu(log_differences), log_differences)
    return (weights * smooth_absolute(log_differences, loss_parameters)).mean(tuple(range(1, log_differences.ndim)))


def _map_loss(differences: list[Tensor], loss_parameters: Params) -> Tensor:
    """Return the sum of the means of the differences of maps that :func:`map_differences` returns, [T]."""
    means = [smooth_absolute(difference, loss_parameters).mean((1, 2, 3)) for difference in differences]
    return torch.stack(means).sum(0)


def _steepness(maps: Maps) -> Tensor:
    """Return the mean sine of the tilt of normals in each cell, plus a little, so that it has a log, [T, 1, 8, 8]."""
    return adaptive_avg_pool2d(tilt_sine(maps.normal), STEEPNESS_CELLS) + 2 * LEVEL_SINE
