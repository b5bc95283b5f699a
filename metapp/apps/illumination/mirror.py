"""The light that a mirror ball shows: radiance where it is seen, and a lower bound of it where photographs clip.

Beside its picture a task may hold `seen` [3, H, W], linear radiance in some unit, and `certain` [2, H, W] in [0, 1]:
the share of each texel that is seen, and the share where all photographs clip, of which `seen` is a lower bound. What
lies behind the ball is in neither. How balls are photographed and fitted is not known here.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import relu

from metapp.appearance.latlong import mean_luminance, resample_maps, solid_angles
from metapp.learning.task import Batch, Params
from metapp.networks.coded import smooth_absolute

RADIANCE_FLOOR = 0.01  # radiance over the mean luminance of what is seen, below which its log is flat
CLIPPED_DISPLAY_VALUE = 0.98  # display value from which a photograph of a ball is a lower bound of the light
# least light of a clipped texel, over the light at which it clips; General says how much more; best in validation
CLIPPED_LIGHT_FACTOR = 2.0


def resample_seen(seen: Tensor, certain: Tensor, height: int, width: int) -> dict[str, Tensor]:
    """Resample the light in a mirror to another size.

    Args:
        seen: linear radiance [3, h, w].
        certain: shares of texels that are seen, and that clip, [2, h, w].
        height: rows of the result.
        width: columns of the result.

    Returns:
        `seen` [3, height, width] and `certain` [2, height, width].
    """
    shares = resample_maps(certain, height, width).clamp(0, 1)
    weight = certain.sum(0, keepdim=True)
    mean = resample_maps(seen * weight, height, width) / resample_maps(weight, height, width).clamp_min(1e-6)
    return {"seen": mean, "certain": shares}


def scale_to_seen(maps: Tensor, data: Batch) -> Tensor:
    """Scale maps [T, 3, H, W] to the unit of the light in the mirror: both are equally bright where it is seen.

    Args:
        maps: linear radiance [T, 3, H, W].
        data: holds `seen` [T, 3, H, W] and `certain` [T, 2, H, W].
    """
    seen_share = data["certain"][:, :1]
    ratio = mean_luminance(data["seen"] * seen_share) / mean_luminance(maps * seen_share).clamp_min(1e-9)
    return maps * torch.where(ratio > 0, ratio, 1.0)[:, None, None, None]


def complete_maps(maps: Tensor, data: Batch) -> Tensor:
    """Return the light in the mirror where it is seen, and maps in its unit elsewhere, [T, 3, H, W].

    Where photographs clip, the map's radiance counts, but at least CLIPPED_LIGHT_FACTOR times the lower bound.

    Args:
        maps: linear radiance [T, 3, H, W].
        data: holds `seen` [T, 3, H, W] and `certain` [T, 2, H, W].
    """
    completed, (seen_share, clipped_share) = scale_to_seen(maps, data), data["certain"].split(1, 1)
    bounded = torch.maximum(completed, CLIPPED_LIGHT_FACTOR * data["seen"])
    completed = torch.lerp(completed, bounded, clipped_share / (1 - seen_share).clamp_min(1e-6))
    return torch.lerp(completed, data["seen"], seen_share)


def shows_mirror(data: Batch) -> Tensor:
    """Tell which tasks show a mirror, bool [T]."""
    return data["certain"].flatten(1).amax(1) > 0


def mirror_loss(maps: Tensor, data: Batch, loss_parameters: Params) -> Tensor:
    """Return the mean difference of log radiance from the light in the mirror, [T].

    Where photographs clip, only darker maps differ.

    Args:
        maps: linear radiance [T, 3, H, W].
        data: holds `seen` [T, 3, H, W] and `certain` [T, 2, H, W].
        loss_parameters: the values that a rule has learned; {} for none.
    """
    seen, (seen_share, clipped_share) = data["seen"], data["certain"].split(1, 1)
    floor = RADIANCE_FLOOR * mean_luminance(seen)[:, None, None, None] + 1e-9
    shortfall = (seen + floor).log() - (scale_to_seen(maps, data) + floor).log()
    weights = solid_angles(*maps.shape[-2:], dtype=maps.dtype, device=maps.device) / (4 * math.pi)
    seen_differences = seen_share * smooth_absolute(shortfall, loss_parameters)
    differences = seen_differences + clipped_share * smooth_absolute(relu(shortfall), loss_parameters)
    result: Tensor = (differences * weights).sum((2, 3)).mean(1)
    return result
