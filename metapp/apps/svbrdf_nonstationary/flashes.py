"""Flashes of photographs: their raw parameters, which are unbounded numbers, and how maps look under them.

Fits of one photograph and of several share the numbers and their units; they differ in how the camera moves with the
flash, see :data:`CameraMotion`.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import torch
from torch import Tensor

from metapp.appearance.flash import camera_distance, camera_position, render_maps, texel_positions
from metapp.appearance.svbrdf_maps import Maps

FLASH_NUMBERS = 4  # raw parameters of a flash: its shift in x and y, its height, its gain
# What 1 of such a number means: half sides of the patch, the log of a factor of the height, the log of the gain
FLASH_SHIFT, FLASH_LOG_HEIGHT, FLASH_LOG_GAIN = 0.3, 0.2, 0.3

# How numbers that move a flash move the camera:
# "fixed": not at all;
# "raised": its height is multiplied by the factor of the flash's height, as in crops of photographs and behind longer
#     lenses, which are as if from farther away;
# "held": as the flash, in x and y, too, since a hand-held device has both side by side.
CameraMotion = Literal["fixed", "raised", "held"]


class Flash(NamedTuple):
    """Flashes, and the positions of the cameras that photographed with them, with any leading axes (written B).

    Attributes:
        place: the position of the flash in half sides of the patch, [B, 3].
        gain: the intensity of the flash, which exposure is a part of, [B, 1]; see
            :func:`metapp.appearance.flash.render_maps`.
        eye: the position of the camera in half sides of the patch, [B, 3]; [3] if all photographs have one.
        falloff: power of the cosine of the angle with the flash's axis, which points at the middle of the patch, [B];
            it stands for the beam of the flash and the vignetting of the lens.
    """

    place: Tensor
    gain: Tensor
    eye: Tensor
    falloff: Tensor


def decode_flash(
    numbers: Tensor,
    places: Tensor | None = None,
    falloff: Tensor | float = 0.0,
    *,
    camera: CameraMotion = "fixed",
) -> Flash:
    """Return the flashes, and the positions of the cameras, of raw parameters.

    Zeros are a flash at its measured position, in whose light a white patch right below it has radiance 1,
    whatever the height, since exposure makes up for that.

    Args:
        numbers: the numbers of each flash, [B, FLASH_NUMBERS]: its shift in x and y, the log of the factor of its
            height, and the log of its gain, in the units FLASH_SHIFT, FLASH_LOG_HEIGHT and FLASH_LOG_GAIN.
        places: measured positions of camera and flash, [B, 2, 3], in half sides of the patch; None for both at
            `camera_position`.
        falloff: the fall-off of the flashes, which broadcasts to [B]; see :class:`Flash`.
        camera: how the camera moves with the flash.
    """
    shift, log_height, log_gain = numbers.split((2, 1, 1), -1)
    shift, height_factor = FLASH_SHIFT * shift, torch.exp(FLASH_LOG_HEIGHT * log_height)
    if places is None:
        eye = place = camera_position(dtype=numbers.dtype, device=numbers.device)
    else:
        eye, place = places.unbind(-2)
    place = _move(place, shift, height_factor)
    if camera != "fixed":
        eye = _move(eye, shift if camera == "held" else torch.zeros_like(shift), height_factor)
    gain = torch.exp(FLASH_LOG_GAIN * log_gain) * (place[..., 2:] / camera_distance()) ** 2
    return Flash(place, gain, eye, falloff + torch.zeros_like(gain[..., 0]))


def _move(position: Tensor, shift: Tensor, height_factor: Tensor) -> Tensor:
    """Shift positions [B, 3] in x and y by [B, 2], and multiply their heights by [B, 1]."""
    return torch.cat([position[..., :2] + shift, position[..., 2:] * height_factor], -1)


def render_photo(maps: Maps, flash: Flash, positions: Tensor | None = None) -> Tensor:
    """Return the radiance [B, 3, H, W] of maps [B, C, H, W] under a flash.

    Args:
        maps: the maps of all of the patch, or of the part of it that `positions` says.
        flash: the flash of each photograph; its leading axes and those of maps broadcast.
        positions: the positions of the texels, [B, 2, H, W]; None if the maps are of all of the patch.
    """
    diffuse = maps.diffuse
    if positions is None:
        positions = texel_positions(*diffuse.shape[-2:], dtype=diffuse.dtype, device=diffuse.device)
    return render_maps(
        maps, positions, flash.place, flash.eye, intensity=flash.gain, falloff=flash.falloff, axis=-flash.place
    )


def render_photos(maps: Maps, flashes: Flash) -> Tensor:
    """Return the radiance [T, N, 3, H, W] of maps [T, C, H, W] under each of the flashes [T, N] of a task."""
    return render_photo(Maps(*(part[:, None] for part in maps)), flashes)


def photograph_by(flash: Flash, maps: Maps) -> Tensor:
    """Return the radiance [3, H, W] of maps [1, C, H, W] under a flash without leading axes."""
    return render_photo(maps, Flash(*(part[None] for part in flash)))[0]
