"""The flashes of several photographs, and how photographs look under them."""

from __future__ import annotations

import torch
from torch import Tensor

from metapp.appearance.flash_rendering import camera_distance, texel_positions
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.maps import (
    CLIPPED_LINEAR_VALUE,
    FLASH_LOG_GAIN,
    FLASH_LOG_HEIGHT,
    FLASH_NUMBERS,
    FLASH_SHIFT,
    Flash,
    render_photo,
)
from metapp.learning.task import Batch

LIGHT_FLOOR = 0.03  # radiance, 1 is white, that is added before logs


def decode_flashes(flash: Tensor, places: Tensor, falloff: Tensor | float = 0.0) -> Flash:
    """Return the flashes, and the cameras beside them, that unbounded numbers stand for.

    Of the numbers of a flash the first two shift it in x and y, the third is a log factor of its height, the fourth a
    log gain; FLASH_SHIFT, FLASH_LOG_HEIGHT and FLASH_LOG_GAIN are their units. In a hand-held device the flash sits
    beside the lens, so shift and factor move the camera, too. Zeros stand for a flash at its measured position, in
    whose light a white patch right below it has radiance 1, whatever the height.

    Args:
        flash: the numbers, [T, FLASH_NUMBERS, N].
        places: measured positions of camera and flash, [T, N, 2, 3], in half sides of the patch.
        falloff: the fall-off that all flashes of a task share, [T, 1]; a number for all tasks. See :class:`Flash`.

    Returns:
        Flashes with two leading axes, tasks and photographs: `place` [T, N, 3], `gain` [T, N, 1], `eye` [T, N, 3] and
        `falloff` [T, N].
    """
    shift, height_factor, gain = flash.mT.split((2, 1, 1), -1)
    height_factor = torch.exp(FLASH_LOG_HEIGHT * height_factor)
    eye, place = torch.cat(
        [places[..., :2] + FLASH_SHIFT * shift[:, :, None], places[..., 2:] * height_factor[:, :, None]], -1
    ).unbind(2)
    gain = torch.exp(FLASH_LOG_GAIN * gain) * (place[..., 2:] / camera_distance()) ** 2
    return Flash(place, gain, eye, falloff + torch.zeros_like(gain[..., 0]))


def render_photos(maps: Maps, flashes: Flash) -> Tensor:
    """Return the radiance [T, N, 3, H, W] of maps [T, C, H, W] under each of N flashes."""
    diffuse = maps.diffuse
    place = texel_positions(*diffuse.shape[-2:], dtype=diffuse.dtype, device=diffuse.device)
    return render_photo(Maps(*(part[:, None] for part in maps)), flashes, place)


@torch.no_grad()
def estimate_flashes(maps: Maps, batch: Batch) -> Tensor:
    """Estimate how bright each flash is, given the maps, and leave it at its measured position.

    The log gain of a flash is the median over texels of the difference of the log photograph from the log rendering of
    the maps, where clipped values count as no difference.

    Args:
        maps: the maps [T, C, H, W].
        batch: `photos` and `places`.

    Returns:
        Unbounded numbers [T, FLASH_NUMBERS, N] that stand for the flashes, see :func:`decode_flashes`: all are 0 but
        the last of each flash, its gain.
    """
    places, photos = batch["places"], batch["photos"]
    zeros = places.new_zeros(len(places), FLASH_NUMBERS, places.shape[1])
    log_gains = log_radiance(photos) - log_radiance(render_photos(maps, decode_flashes(zeros, places)))
    log_gains = torch.where(photos > CLIPPED_LINEAR_VALUE, 0, log_gains).mean(2).flatten(2).median(2).values
    return torch.cat([zeros[:, :-1], log_gains[:, None] / FLASH_LOG_GAIN], 1)


def log_radiance(radiance: Tensor) -> Tensor:
    """Return the logs of radiance plus LIGHT_FLOOR."""
    return (radiance + LIGHT_FLOOR).log()
