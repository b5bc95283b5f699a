"""Differences of environment maps: in the log radiance of texels, and in the radiance that surfaces reflect."""

from __future__ import annotations

import math
from typing import NamedTuple

from torch import Tensor

from metapp.appearance.latlong import resample_maps, solid_angles
from metapp.apps.illumination.spheres import surface_transfer
from metapp.learning.rounding import smooth_absolute
from metapp.learning.task import Params, Task
from metapp.networks.field import LocalField

RADIANCE_FLOOR = 0.01  # radiance in a map of mean luminance 1, below which its log is flat
INITIAL_SMOOTHING = 0.3  # of |d| in losses, in their unit, before a rule has learned it
REFLECTED_RADIANCE_FLOOR = 0.02  # radiance that a white surface reflects under such a map, below which its log is flat


class TrueMap(NamedTuple):
    """A map with which fitted maps are compared.

    Attributes:
        map: linear radiance [T, 3, H, W], of mean luminance 1, at the size of fits.
        reflected: the radiance that surfaces reflect under the map, [T, 3, S], see :func:`reflect_radiance`.
    """

    map: Tensor
    reflected: Tensor


def describe_maps(maps: Tensor) -> TrueMap:
    """Return maps [T, 3, H, W] of the size of fits with the radiance that surfaces reflect under them."""
    return TrueMap(maps, reflect_radiance(maps))


def prepare_map(task: Task, network: LocalField) -> TrueMap:
    """Return the map of one task, at the size of a network's maps, with a task axis of length 1."""
    return describe_maps(resample_maps(task.data["map"][None].float(), network.height, network.width))


def reflect_radiance(maps: Tensor) -> Tensor:
    """Return the radiance [T, 3, S] that S white surfaces reflect under radiance maps [T, 3, H, W].

    First come FACING_SURFACES diffuse surfaces, whose normals are spread evenly over all directions. Then come
    MIRRORING_SURFACES glossy surfaces, which are rough; the directions around which they gather light for a viewer at
    +z are spread evenly, too.
    """
    height, width = maps.shape[-2:]
    return maps.flatten(2) @ surface_transfer(height, width, maps.device).to(maps).T


def compare_reflected_radiance(maps: Tensor, target: Tensor, loss_parameters: Params) -> tuple[Tensor, Tensor]:
    """Compare the radiance that S surfaces reflect under maps with a target.

    Args:
        maps: linear radiance [T, 3, H, W].
        target: the radiance that the surfaces reflect under the true maps, [T, 3, S].
        loss_parameters: the values that a rule has learned; {} for none.

    Returns:
        Absolute differences of the radiance and of its log, [T, 3, S] each; see :func:`smooth_absolute`.
    """
    reflected = reflect_radiance(maps)
    log_difference = (reflected + REFLECTED_RADIANCE_FLOOR).log() - (target + REFLECTED_RADIANCE_FLOOR).log()
    return smooth_absolute(reflected - target, loss_parameters), smooth_absolute(log_difference, loss_parameters)


def compare_texels(maps: Tensor, target: Tensor, loss_parameters: Params, light_weight: Tensor | float) -> Tensor:
    """Return the mean difference of the logs of radiance, [T].

    A texel counts by its solid angle, times 1 + `light_weight` times the target's radiance there, which is 1 on
    average.

    Args:
        maps: linear radiance [T, 3, H, W].
        target: true maps [T, 3, H, W], of mean luminance 1.
        loss_parameters: the values that a rule has learned; {} for none.
        light_weight: what the target's radiance adds to a texel's weight, a number or [T, 1, 1, 1].
    """
    weights = solid_angles(*maps.shape[-2:], dtype=maps.dtype, device=maps.device) / (4 * math.pi)
    weights = weights * (1 + light_weight * target.mean(1, keepdim=True))
    differences = smooth_absolute((maps + RADIANCE_FLOOR).log() - (target + RADIANCE_FLOOR).log(), loss_parameters)
    return (differences * weights).sum((2, 3)).mean(1)
