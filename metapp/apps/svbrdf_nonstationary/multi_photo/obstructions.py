"""Parts of photographs that show something else than the material: a finger, a coin that was moved, a shadow.

Of several photographs of one place, those that show the material agree with one Lambertian surface, and those that show
something else do not. So photometric stereo is solved without each photograph and without each pair of them, and the
fewest are left out by which the others agree (least trimmed squares: Rousseeuw 1984). Only parts that are darker than
the others predict are left out: a brighter part may be a highlight of the material, which tells its roughness.
"""

from __future__ import annotations

from itertools import combinations

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool2d, interpolate, max_pool2d, pad, relu

from metapp.apps.svbrdf_nonstationary.multi_photo.stereo import (
    NOISE_VALUE,
    STEREO_CLIPPED_LINEAR_VALUE,
    photometric_stereo,
    read_stereo,
)

MIN_PHOTOS = 5  # so that at least three remain, by which a Lambertian texel is known
MAX_LEFT_OUT = 2  # photographs of a place that may show something else
COMPARED_PX = 64  # side of the photographs that are compared
WINDOW_PX = 5  # side of the windows over which their deviations are averaged: relief deviates texel by texel
# A photograph is left out where its log colours are off by more than the first, and by more than the second times the
# third quantile of deviations, so that materials which are not Lambertian lose nothing.
MIN_LOG_DEVIATION, MIN_OVER_TYPICAL, TYPICAL_QUANTILE = 0.25, 6.0, 0.85
MIN_LOG_DARKNESS = 0.1  # of what is left out: coins and shadows have 0.2 to 1.8, rims of highlights up to 0.03
MIN_PART_SIDE = 0.06  # sides of the patch: smaller parts are noise
GROWN_PX = 2  # by which parts are enlarged, since windows at their edges hold some of the material
MAX_PHOTO_SHARE = 0.5  # of a photograph that may show something else; more is a surface that stereo does not explain
LEAST_LAMBERTIAN = 0.2  # of the brightness of a facing texel, below which predictions are not trusted


@torch.no_grad()
def remove_obstructions(photos: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
    """Find the parts of photographs that show something else than the material, and fill them by the other photographs.

    Args:
        photos: linear photographs [N, 3, H, W].
        places: positions of camera and flash, [N, 2, 3], in half sides of the patch.

    Returns:
        The photographs, [N, 3, H, W], in whose parts the Lambertian surface of the other photographs is rendered; and
        where they show the material, 1 or 0, [N, 1, H, W]. Nothing changes where there are fewer than MIN_PHOTOS.
    """
    shows_material = torch.ones_like(photos[:, :1])
    if len(photos) < MIN_PHOTOS or min(photos.shape[-2:]) < COMPARED_PX:
        return photos, shows_material
    parts = _find_parts(adaptive_avg_pool2d(photos, COMPARED_PX), places)
    if not parts.any():
        return photos, shows_material
    shows_material = 1 - (interpolate(parts, photos.shape[-2:], mode="bilinear") > 0.5).to(photos)
    log_ratios = _compare_with_lambertian(photos, places, shows_material[None])[0]
    return torch.where(shows_material > 0, photos, (photos * (-log_ratios).exp()).clamp(0, 1)), shows_material


def _find_parts(photos: Tensor, places: Tensor) -> Tensor:
    """Find the parts that disagree with other photographs.

    Args:
        photos: linear photographs [N, 3, h, w].
        places: positions of camera and flash, [N, 2, 3], in half sides of the patch.

    Returns:
        The parts, enlarged by GROWN_PX, 1 or 0, [N, 1, h, w].
    """
    numbers = range(len(photos))
    left_out = [subset for size in range(MAX_LEFT_OUT + 1) for subset in combinations(numbers, size)]
    kept = photos.new_tensor([[number not in subset for number in numbers] for subset in left_out])
    kept = kept[:, :, None, None, None].expand(-1, -1, -1, *photos.shape[-2:])
    log_ratios = _compare_with_lambertian(photos, places, kept)
    log_ratios = _average(log_ratios.flatten(0, 1), WINDOW_PX).unflatten(0, kept.shape[:2])
    darker, brighter = (relu(sign * log_ratios).mean(2, keepdim=True) for sign in (-1, 1))
    deviations = sum(deviation / _price(deviation[0]) for deviation in (darker, brighter))
    best_subset = ((kept * deviations).sum(1) + (1 - kept).sum(1)).argmin(0)[None, None]  # [1, 1, 1, h, w]
    is_left_out, log_darkness = (values.take_along_dim(best_subset, 0)[0] for values in (1 - kept, darker - brighter))
    # A photograph that is brighter than the others predict may show a highlight of the material.
    parts = is_left_out * (log_darkness > MIN_LOG_DARKNESS)
    # A part holds most of a window around it: smaller ones are noise.
    parts = parts * (_average(parts, 2 * round(MIN_PART_SIDE * COMPARED_PX / 2) + 1) > 0.5)
    parts = parts * (parts.mean((1, 2, 3), keepdim=True) <= MAX_PHOTO_SHARE)
    return max_pool2d(parts, 2 * GROWN_PX + 1, 1, GROWN_PX)


def _price(deviations: Tensor) -> Tensor:
    """Return the deviation by which a photograph must be off to be left out, given all deviations [N, 1, h, w]."""
    typical_deviation = deviations.flatten().quantile(TYPICAL_QUANTILE)
    return (MIN_OVER_TYPICAL * typical_deviation).clamp_min(MIN_LOG_DEVIATION)


def _compare_with_lambertian(photos: Tensor, places: Tensor, kept: Tensor) -> Tensor:
    """Return the logs of photographs over the Lambertian surfaces of those that are kept.

    Args:
        photos: linear photographs [N, 3, h, w].
        places: positions of camera and flash, [N, 2, 3], in half sides of the patch.
        kept: for each of S surfaces where each photograph counts, 1 or 0, [S, N, 1, h, w].

    Returns:
        The logs, [S, N, 3, h, w], within -3 to 3.
    """
    reading = read_stereo(photos[None], places[None])
    brightness = photos.mean(1, keepdim=True).clamp_min(NOISE_VALUE / 4)
    valid = 1 - 0.98 * (photos.amax(1, keepdim=True) > STEREO_CLIPPED_LINEAR_VALUE).to(photos)
    colour = photos.clamp_min(NOISE_VALUE / 4) / brightness * reading.grey[0]
    grey = reading.grey.expand(len(kept), -1, -1, -1, -1)
    _, slopes, weights, _ = photometric_stereo(grey, reading.tangents, kept * valid, NOISE_VALUE / 2 / brightness)
    lambertian = (1 + (slopes[:, None] * reading.tangents).sum(2, keepdim=True)).clamp_min(LEAST_LAMBERTIAN)
    weights = weights * kept
    total_weight = weights.sum(1, keepdim=True).clamp_min(1e-6)  # 0 where enlarged parts of all photographs meet
    facing_colour = (weights * colour / lambertian).sum(1, keepdim=True).clamp_min(1e-6) / total_weight
    return (colour / (facing_colour * lambertian)).log().clamp(-3, 3)


def _average(pictures: Tensor, window: int) -> Tensor:
    """Return the means of pictures [B, C, h, w] over windows of an odd side."""
    margin = window // 2
    return avg_pool2d(pad(pictures, (margin, margin, margin, margin), mode="replicate"), window, 1)
