"""The light that a mirror ball shows: taken as it is where it is seen, a bound where it clips.

Beside its picture a task may hold `seen` [3, H, W], linear radiance in some unit, and `certain` [2, H, W] in [0, 1]:
the share of each texel that is seen, and the share where all photographs clip, of which `seen` is a lower bound. What
lies behind the ball is in neither.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import relu

from metapp.appearance.latlong import mean_luminance, resample_maps, solid_angles
from metapp.learning.task import Batch, Params
from metapp.networks.coded import smooth_absolute

RADIANCE_FLOOR = 0.01  # of the mean of what is seen: the log of radiance is flat below
CLIPPED_VALUE = 0.98  # display value from which a photograph says no more
CLIPPED_LIGHT_FACTOR = (
    2.0  # times the light of the clip is there at least; General tells how much more, best so in validation
)


def resample_seen(seen: Tensor, certain: Tensor, height: int, width: int) -> dict[str, Tensor]:
    """The light that is seen, `seen` [3, H, W] and `certain` [2, H, W], at another resolution."""
    shares = resample_maps(certain, height, width).clamp(0, 1)
    weight = certain.sum(0, keepdim=True)
    mean = resample_maps(seen * weight, height, width) / resample_maps(weight, height, width).clamp_min(1e-6)
    return {"seen": mean, "certain": shares}


def scale_to_seen(maps: Tensor, data: Batch) -> Tensor:
    """Maps [T, 3, H, W] in the unit of visible light: of equal light where that is certain."""
    sure = data["certain"][:, :1]
    ratio = mean_luminance(data["seen"] * sure) / mean_luminance(maps * sure).clamp_min(1e-9)
    return maps * torch.where(ratio > 0, ratio, 1.0)[:, None, None, None]


def complete_maps(maps: Tensor, data: Batch) -> Tensor:
    """The light that is seen, and maps [T, 3, H, W] where none is, in its unit.

    Where it clips, the brighter of both counts, as if some light was lost for certain.
    """
    filled, (sure, clipped) = scale_to_seen(maps, data), data["certain"].split(1, 1)
    filled = torch.lerp(
        filled, torch.maximum(filled, CLIPPED_LIGHT_FACTOR * data["seen"]), clipped / (1 - sure).clamp_min(1e-6)
    )
    return torch.lerp(filled, data["seen"], sure)


def shows_mirror(data: Batch) -> Tensor:
    """Which tasks show a mirror, bool [T]."""
    return data["certain"].flatten(1).amax(1) > 0


def mirror_loss(maps: Tensor, data: Batch, learned: Params) -> Tensor:
    """Mean difference of the logs of radiance, [T]; where the ball clips, only darker maps differ."""
    seen, (sure, clipped) = data["seen"], data["certain"].split(1, 1)
    floor = RADIANCE_FLOOR * mean_luminance(seen)[:, None, None, None] + 1e-9
    short = (seen + floor).log() - (scale_to_seen(maps, data) + floor).log()
    weights = solid_angles(*maps.shape[-2:], dtype=maps.dtype, device=maps.device) / (4 * math.pi)
    differences = sure * smooth_absolute(short, learned) + clipped * smooth_absolute(relu(short), learned)
    result: Tensor = (differences * weights).sum((2, 3)).mean(1)
    return result
