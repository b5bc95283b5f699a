"""The gains of the flashes of several photographs, by logs of photographs and of renderings."""

from __future__ import annotations

import torch
from torch import Tensor

from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.flashes import FLASH_LOG_GAIN, FLASH_NUMBERS, decode_flash, render_photos
from metapp.apps.svbrdf_nonstationary.maps import CLIPPED_LINEAR_VALUE

LIGHT_FLOOR = 0.03  # radiance, 1 is white, that is added before logs


@torch.no_grad()
def estimate_flashes(maps: Maps, photos: Tensor, places: Tensor) -> Tensor:
    """Estimate how bright each flash is, given the maps, and leave it at its measured position.

    The log gain of a flash is the median over texels of the difference of the log photograph from the log rendering of
    the maps, where clipped values count as no difference.

    Args:
        maps: the maps [T, C, H, W].
        photos: linear photographs [T, N, 3, H, W].
        places: measured positions of camera and flash, [T, N, 2, 3], in half sides of the patch.

    Returns:
        Raw parameters [T, FLASH_NUMBERS, N] of the flashes, see :func:`decode_flash`: all are 0 but the
        last of each flash, its gain.
    """
    zeros = places.new_zeros(len(places), FLASH_NUMBERS, places.shape[1])
    log_gains = log_floored_radiance(photos) - log_floored_radiance(
        render_photos(maps, decode_flash(zeros.mT, places, camera="held"))
    )
    log_gains = torch.where(photos > CLIPPED_LINEAR_VALUE, 0, log_gains).mean(2).flatten(2).median(2).values
    return torch.cat([zeros[:, :-1], log_gains[:, None] / FLASH_LOG_GAIN], 1)


def log_floored_radiance(radiance: Tensor) -> Tensor:
    """Return the logs of radiance plus LIGHT_FLOOR."""
    return (radiance + LIGHT_FLOOR).log()
