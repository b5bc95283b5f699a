"""The decoder of maps that are the mean of two fields: the field of features, and the field of the recipe "full"."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.field_maps import FieldMaps
from metapp.apps.svbrdf_nonstationary.flashes import Flash
from metapp.apps.svbrdf_nonstationary.maps import CHANNELS, decode_maps
from metapp.apps.svbrdf_nonstationary.photographed_maps import PhotographedMaps
from metapp.apps.svbrdf_nonstationary.pretrained.encoder import (
    FULL_FIELD,
    FULL_PREFIX,
    FULL_SHARE,
    scale_slopes,
    unknown_deviation,
)
from metapp.learning.task import Params
from metapp.networks.field import LocalField

# The predicted slope that is halved before the gain, and the gain of all slopes; chosen by validation materials
HALVED_SLOPE, SLOPE_GAIN = 0.1, 1.5


class MeanField(LocalField):
    """A field beside the field of the recipe "full": the mean of both, but slopes of the first alone.

    Networks with other features and other training materials make other errors, which the mean lowers. `z` holds the
    codes of both fields, that of the first field first.
    """

    @override
    def init(self, rng: Generator, count: int) -> Params:
        """Draw random parameters of both fields, [count, ...] each."""
        full = FULL_FIELD._replace(rows=self.rows, columns=self.columns)
        theta, full_theta = super().init(rng, count), full.init(rng, count)
        z = torch.cat([theta["z"], full_theta.pop("z")], 1)
        return theta | {f"{FULL_PREFIX}{key}": value for key, value in full_theta.items()} | {"z": z}

    @override
    def evaluate(self, theta: Params, code: Tensor, places: Tensor) -> Tensor:
        """Evaluate the mean of both fields; `code` has the codes of both at the texels, the first field's first."""
        return self.mix_outputs(*self.evaluate_both(theta, code, places))

    def evaluate_both(self, theta: Params, code: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluate the first field and the field of "full" at texels, [T, outputs, h, w] each; see :meth:`evaluate`."""
        full_theta = {
            key.removeprefix(FULL_PREFIX): value for key, value in theta.items() if key.startswith(FULL_PREFIX)
        }
        first_output = super().evaluate(theta, code[:, : self.code], places)
        return first_output, FULL_FIELD.evaluate(full_theta, code[:, self.code :], places)

    def mix_outputs(self, first_output: Tensor, full_output: Tensor) -> Tensor:
        """Return the mean of both outputs [T, outputs, h, w], weighted by FULL_SHARE; slopes are of the first alone."""
        slopes, rest = first_output.split((CHANNELS[0], sum(CHANNELS[1:])), 1)
        return torch.cat([slopes, torch.lerp(rest, full_output[:, CHANNELS[0] :], FULL_SHARE)], 1)


class UncertainMaps(NamedTuple):
    """Maps as they are trained: with the errors that General predicts for them.

    Attributes:
        maps: the maps, [T, C, H, W].
        flash: the flash, with a task axis.
        deviation: logs of the predicted errors of maps, [T, 4, h, w].
    """

    maps: Maps
    flash: Flash
    deviation: Tensor


@dataclass(frozen=True)
class MeanFieldMaps(FieldMaps):
    """The decoder of maps of two fields. Steps of fits change the code of the second field and the flash alone."""

    network: MeanField

    @override
    def init(self, rng: Generator, count: int) -> Params:
        """Draw parameters of maps that are nearly flat, as steps of fits leave normals as they are."""
        return scale_slopes(super().init(rng, count)) | unknown_deviation(count, rng.device)

    @override
    def finish_maps(self, raw: Tensor) -> Maps:
        """Return the maps of outputs of fields, with slopes s changed to SLOPE_GAIN s |s|^2 / (|s|^2 + HALVED_SLOPE^2).

        The network makes conditional means; the mean difference of normals asks for medians, which are flat where a
        photograph tells little, and steeper where it tells a lot.
        """
        slopes, rest = raw.split((CHANNELS[0], sum(CHANNELS[1:])), 1)
        square = slopes.square().sum(1, keepdim=True)
        return decode_maps(torch.cat([SLOPE_GAIN * square / (square + HALVED_SLOPE**2) * slopes, rest], 1))

    @override
    def decode_for_steps(self, theta: Params, seen: Any) -> PhotographedMaps:
        """Return maps in which the code of "full" alone has a gradient, and the flash.

        So normals stay those of General: a photograph under one light says less of them than General has read.
        """
        fixed_theta = {key: value.detach() for key, value in theta.items()}
        first_output, full_output = self.network.evaluate_both(fixed_theta, self.network.gain * theta["z"], seen.inputs)
        maps = self.finish_maps(self.network.mix_outputs(first_output.detach(), full_output))
        return PhotographedMaps(maps, self.decode_flash_numbers(theta["flash"], seen.camera_height))

    @override
    def decode_for_training(self, theta: Params, seen: Any) -> UncertainMaps:
        """Return maps with the slopes that the network makes, for photographs with a code in each pixel.

        Training on changed slopes would undo the change.
        """
        maps = decode_maps(self.network.evaluate(theta, self.network.gain * theta["z"], seen.inputs))
        return UncertainMaps(maps, self.decode_flash_numbers(theta["flash"], seen.camera_height), theta["deviation"])

    @override
    def postprocess(self, theta: Params) -> Params:
        """Return fits without predicted errors, which training alone reads."""
        return {key: value for key, value in theta.items() if key != "deviation"}
