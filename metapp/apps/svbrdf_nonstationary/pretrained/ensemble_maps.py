"""The decoder of maps that are the mean of two fields: the field of features, and the field of the recipe "full"."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.encoder import BASE_TEXELS
from metapp.apps.svbrdf_nonstationary.field_maps import FieldMaps
from metapp.apps.svbrdf_nonstationary.flashes import Flash
from metapp.apps.svbrdf_nonstationary.maps import CHANNELS, decode_maps
from metapp.apps.svbrdf_nonstationary.photographed_maps import PhotographedMaps
from metapp.apps.svbrdf_nonstationary.pretrained.patch import FULL_DECODER
from metapp.learning.task import Params, select_prefixed

SECOND_PREFIX = "full."  # of names of the second field's parameters beside the first field's
SECOND_SHARE = 0.5  # weight of the second field in diffuse colour, roughness and specular colour; it has none in slopes
INITIAL_SLOPE_GAIN = 0.05  # factor of slopes of untrained fields, whose maps are nearly flat
# The predicted slope that is halved before the gain, and the gain of all slopes; chosen by validation materials
HALVED_SLOPE, SLOPE_GAIN = 0.1, 1.5
PARTS = ("diffuse", "specular", "roughness", "normal")  # maps with a predicted error, in the order of `map_differences`
UNKNOWN_LOG = 10.0  # log of a predicted error where nothing is known of it


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
class EnsembleMaps(FieldMaps):
    """The decoder of maps that are the mean of two fields, but for slopes, which are the first field's alone.

    Networks with other features and other training materials make other errors, which the mean lowers. Steps of fits
    change the code of the second field and the flash alone.

    Attributes:
        second: the decoder of maps of the second field.
    """

    second: FieldMaps = FULL_DECODER

    @override
    def init(self, rng: Generator, count: int) -> Params:
        """Draw parameters of maps that are nearly flat, as steps of fits leave normals as they are."""
        second_field = self.second.network._replace(rows=self.network.rows, columns=self.network.columns)
        first_theta, second_theta = scale_slopes(super().init(rng, count)), second_field.init(rng, count)
        return join_fields(first_theta, second_theta) | unknown_deviation(count, rng.device)

    @override
    def evaluate(self, theta: Params, inputs: Tensor) -> Tensor:
        return mix_outputs(*self.evaluate_both(theta, inputs))

    @override
    def evaluate_by_rows(self, theta: Params, inputs: Tensor) -> Iterator[Tensor]:
        first_theta, second_theta = self.split_fields(theta)
        first_rows = super().evaluate_by_rows(first_theta, inputs)
        return map(mix_outputs, first_rows, self.second.evaluate_by_rows(second_theta, inputs))

    def evaluate_both(self, theta: Params, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluate the first and the second field in all pixels; see :meth:`FieldMaps.evaluate`."""
        first_theta, second_theta = self.split_fields(theta)
        return super().evaluate(first_theta, inputs), self.second.evaluate(second_theta, inputs)

    def split_fields(self, theta: Params) -> tuple[Params, Params]:
        """Return the parameters of the first and of the second field, which :func:`join_fields` joined."""
        first_code, second_code = theta["z"].split((self.network.code, self.second.network.code), 1)
        return theta | {"z": first_code}, select_second(theta) | {"z": second_code}

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
        """Return maps in which the code of the second field alone has a gradient, and the flash.

        So normals stay those of General: a photograph under one light says less of them than General has read.
        """
        fixed_theta = {name: value.detach() for name, value in theta.items()} | {"z": theta["z"]}
        first_output, second_output = self.evaluate_both(fixed_theta, seen.inputs)
        maps = self.finish_maps(mix_outputs(first_output.detach(), second_output))
        return PhotographedMaps(maps, self.decode_flash_numbers(theta["flash"], seen.camera_height))

    @override
    def decode_for_training(self, theta: Params, seen: Any) -> UncertainMaps:
        """Return maps with the slopes that the network makes, for photographs with a code in each pixel.

        Training on changed slopes would undo the change.
        """
        maps = decode_maps(self.evaluate(theta, seen.inputs))
        return UncertainMaps(maps, self.decode_flash_numbers(theta["flash"], seen.camera_height), theta["deviation"])

    @override
    def postprocess(self, theta: Params) -> Params:
        """Return fits without predicted errors, which training alone reads."""
        return {name: value for name, value in theta.items() if name != "deviation"}


def join_fields(first: Params, second: Params) -> Params:
    """Join the parameters of two fields; `z` holds both codes, the first field's first."""
    codes = torch.cat([first["z"], second["z"]], 1)
    return first | mark_second({name: value for name, value in second.items() if name != "z"}) | {"z": codes}


def mark_second(second: Params) -> Params:
    """Mark the names of the second field's parameters, so that they stand beside the first field's."""
    return {f"{SECOND_PREFIX}{name}": value for name, value in second.items()}


def select_second(theta: Params) -> Params:
    """Select the parameters that :func:`mark_second` marked, by their own names."""
    return select_prefixed(theta, SECOND_PREFIX)


def mix_outputs(first: Tensor, second: Tensor) -> Tensor:
    """Return the mean of outputs [T, 9, h, w] of two fields, weighted by SECOND_SHARE; slopes are the first's alone."""
    slopes, rest = first.split((CHANNELS[0], sum(CHANNELS[1:])), 1)
    return torch.cat([slopes, torch.lerp(rest, second[:, CHANNELS[0] :], SECOND_SHARE)], 1)


def scale_slopes(theta: Params) -> Params:
    """Scale the slopes of the maps of fields with parameters [T, ...] by INITIAL_SLOPE_GAIN."""
    factor = theta["out.shift"].new_tensor([INITIAL_SLOPE_GAIN] * CHANNELS[0] + [1.0] * sum(CHANNELS[1:]))
    last_layer = {name: value for name, value in theta.items() if name.startswith("out.")}
    return theta | {name: factor.reshape(-1, *[1] * (value.ndim - 2)) * value for name, value in last_layer.items()}


def unknown_deviation(count: int, device: torch.device) -> Params:
    """Return `deviation` [count, 4, BASE_TEXELS, BASE_TEXELS] where nothing is known of errors; no step moves it."""
    return {"deviation": torch.full((count, len(PARTS), BASE_TEXELS, BASE_TEXELS), UNKNOWN_LOG, device=device)}
