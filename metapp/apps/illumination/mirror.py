"""The light that a mirror ball shows: radiance where it is seen, and a lower bound of it where photographs clip."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import relu

from metapp.appearance.latlong import mean_luminance, resample_maps, solid_angles
from metapp.learning.rounding import smooth_absolute
from metapp.learning.task import Params, Task

RADIANCE_FLOOR = 0.01  # radiance over the mean luminance of what is seen, below which its log is flat
CLIPPED_DISPLAY_VALUE = 0.98  # display value from which a photograph of a ball is a lower bound of the light
# least light of a clipped texel, over the light at which it clips; General says how much more; best in validation
CLIPPED_LIGHT_FACTOR = 2.0


class MirrorLight(NamedTuple):
    """The light in mirror balls; what lies behind a ball is in neither tensor.

    Attributes:
        seen: linear radiance in some unit, [T, 3, H, W].
        certain: two shares in [0, 1], [T, 2, H, W]: the share of each texel that is seen, and the share where all
            photographs clip, so that `seen` is a lower bound.
    """

    seen: Tensor
    certain: Tensor


def read_mirror_light(task: Task, height: int, width: int) -> MirrorLight:
    """Return the light in the mirror ball of a task, resampled to height x width texels, without a task axis.

    It is zeros for a task without light in a mirror, such as one whose photograph shows another sphere.
    """
    if not {"seen", "certain"} <= task.data.keys():
        return MirrorLight(torch.zeros(3, height, width), torch.zeros(2, height, width))
    seen, certain = (task.data[name].float() for name in MirrorLight._fields)
    weight = certain.sum(0, keepdim=True)
    mean = resample_maps(seen * weight, height, width) / resample_maps(weight, height, width).clamp_min(1e-6)
    return MirrorLight(mean, resample_maps(certain, height, width).clamp(0, 1))


def scale_to_seen(maps: Tensor, light: MirrorLight) -> Tensor:
    """Scale maps [T, 3, H, W] to the unit of the light in the mirror: both are equally bright where it is seen.

    Args:
        maps: linear radiance [T, 3, H, W].
        light: the light in the mirrors.
    """
    seen_share = light.certain[:, :1]
    ratio = mean_luminance(light.seen * seen_share) / mean_luminance(maps * seen_share).clamp_min(1e-9)
    return maps * torch.where(ratio > 0, ratio, 1.0)[:, None, None, None]


def complete_maps(maps: Tensor, light: MirrorLight) -> Tensor:
    """Return the light in the mirror where it is seen, and maps in its unit elsewhere, [T, 3, H, W].

    Where photographs clip, the map's radiance counts, but at least CLIPPED_LIGHT_FACTOR times the lower bound.

    Args:
        maps: linear radiance [T, 3, H, W].
        light: the light in the mirrors.
    """
    completed, (seen_share, clipped_share) = scale_to_seen(maps, light), light.certain.split(1, 1)
    bounded = torch.maximum(completed, CLIPPED_LIGHT_FACTOR * light.seen)
    completed = torch.lerp(completed, bounded, clipped_share / (1 - seen_share).clamp_min(1e-6))
    return torch.lerp(completed, light.seen, seen_share)


def shows_mirror(light: MirrorLight) -> Tensor:
    """Tell which tasks show a mirror, bool [T]."""
    return light.certain.flatten(1).amax(1) > 0


def mirror_loss(maps: Tensor, light: MirrorLight, loss_parameters: Params) -> Tensor:
    """Return the mean difference of log radiance from the light in the mirror, [T].

    Where photographs clip, only darker maps differ.

    Args:
        maps: linear radiance [T, 3, H, W].
        light: the light in the mirrors.
        loss_parameters: the values that a rule has learned; {} for none.
    """
    seen, (seen_share, clipped_share) = light.seen, light.certain.split(1, 1)
    floor = RADIANCE_FLOOR * mean_luminance(seen)[:, None, None, None] + 1e-9
    shortfall = (seen + floor).log() - (scale_to_seen(maps, light) + floor).log()
    weights = solid_angles(*maps.shape[-2:], dtype=maps.dtype, device=maps.device) / (4 * math.pi)
    seen_differences = seen_share * smooth_absolute(shortfall, loss_parameters)
    differences = seen_differences + clipped_share * smooth_absolute(relu(shortfall), loss_parameters)
    result: Tensor = (differences * weights).sum((2, 3)).mean(1)
    return result
