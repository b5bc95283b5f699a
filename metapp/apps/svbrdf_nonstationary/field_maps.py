"""The decoder of maps that a small network makes of the photograph and of a code in each place."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.flash import camera_distance
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.flashes import (
    FLASH_LOG_HEIGHT,
    FLASH_NUMBERS,
    CameraMotion,
    Flash,
    decode_flash,
)
from metapp.apps.svbrdf_nonstationary.maps import CHANNELS, PIXEL_INPUTS, decode_maps, pixel_inputs
from metapp.apps.svbrdf_nonstationary.photographed_maps import MaterialDecoder, PhotographedMaps
from metapp.learning.task import Params
from metapp.networks.field import STRIP_TEXELS, LocalField, evaluate_by_rows


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
class FieldMaps(MaterialDecoder[PhotographedMaps, Any]):
    """The decoder of maps that a field makes of a photograph, and of the flash among a fit's parameters.

    Attributes:
        network: the field.
        camera_motion: how the camera moves with the flash. It is "fixed" where photographs show the patch as fits
            expect, and "raised" for photographs that people take, which may be crops.
    """

    network: LocalField
    camera_motion: CameraMotion = "fixed"

    @property
    @override
    def size(self) -> tuple[int, int]:
        """The height and width of the maps in texels."""
        return self.network.height, self.network.width

    @property
    @override
    def is_periodic(self) -> bool:
        return self.network.periodic

    @override
    def init(self, rng: Generator, count: int) -> Params:
        return self.network.init(rng, count) | {"flash": torch.zeros(count, FLASH_NUMBERS, device=rng.device)}

    @override
    def __call__(self, theta: Params, seen: Any) -> PhotographedMaps:
        return self.decode(theta, seen.photo, seen.camera_height)

    @override
    def decode(self, theta: Params, photo: Tensor, cameras: Tensor) -> PhotographedMaps:
        """Return maps and flashes; `cameras` are heights in half sides of the patch, [T, 1], 0 where not known."""
        return PhotographedMaps(self.make_maps(theta, photo), self.decode_flash_numbers(theta["flash"], cameras))

    def make_maps(self, theta: Params, photo: Tensor) -> Maps:
        """Return the maps [T, C, h, w] of fits at the size of linear photographs [T, 3, h, w].

        Maps that are too large for one pass are made by rows: a layer of 2048 x 2048 texels takes 0.5 GB.
        """
        inputs = pixel_inputs(photo)
        if torch.is_grad_enabled() or inputs[0, 0].numel() <= STRIP_TEXELS:
            return self.finish_maps(self.evaluate(theta, inputs))
        strips = [self.finish_maps(rows) for rows in self.evaluate_by_rows(theta, inputs)]
        return Maps(*(torch.cat(strip_maps, -2) for strip_maps in zip(*strips, strict=True)))

    def evaluate(self, theta: Params, inputs: Tensor) -> Tensor:
        """Evaluate raw parameters in all pixels.

        Args:
            theta: the parameters of T fields, whose codes have any size.
            inputs: what fields read of each pixel, [T, PIXEL_INPUTS, h, w].

        Returns:
            Raw parameters of maps, [T, 9, h, w].
        """
        return self.network.resize(theta["z"], inputs)(theta, inputs)

    def evaluate_by_rows(self, theta: Params, inputs: Tensor) -> Iterator[Tensor]:
        """Yield raw parameters from the top, some rows [T, 9, r, w] at a time; see :meth:`evaluate`."""
        return evaluate_by_rows(self.network.resize(theta["z"], inputs), theta, inputs)

    def finish_maps(self, raw: Tensor) -> Maps:
        """Return the maps [T, C, h, w] of raw parameters [T, 9, h, w], the outputs of fields."""
        return decode_maps(raw)

    def decode_flash_numbers(self, flash: Tensor, camera_heights: Tensor) -> Flash:
        """Return the flashes of parameters [T, FLASH_NUMBERS].

        Where a camera that moves has a known height, so has its flash.
        """
        numbers = self.network.gain * flash
        if self.camera_motion == "fixed":
            return decode_flash(numbers)
        x, y, log_height, gain = numbers.split(1, 1)
        known = (camera_heights / camera_distance()).log() / FLASH_LOG_HEIGHT
        log_height = torch.where(camera_heights > 0, known, log_height)
        return decode_flash(torch.cat([x, y, log_height, gain], 1), camera=self.camera_motion)
