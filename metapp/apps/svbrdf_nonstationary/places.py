"""Where people hold camera and flash when they take one or several photographs of a flat material.

Training and the embedded data set draw places by one distribution, whose constants stand here.
"""

from __future__ import annotations

import math

import torch
from torch import Generator, Tensor

from metapp.appearance.flash import camera_distance
from metapp.learning.random_tensors import draw_normal, draw_uniform

ASIDE_HALF_SIDES = 0.6  # farthest from above the middle, of all photographs but the first
# Heights of cameras, over the distance at which a field of view of 45 degrees shows the patch
NEAREST_TIMES, FARTHEST_TIMES = 0.8, 2.2
# Standard deviation of each coordinate of a measured place, as a share of its height: 1 degree, the error of a pose
# that is estimated from a sheet of markers.
PLACE_ERROR = 0.02
# Single photographs: the share whose flash is beside the lens; for the others, standard deviations of the sideways
# offset of the flash in half sides of the patch, and of the natural logarithms of its height and brightness. The
# sideways deviation is the one in the strips of photographs by Deschaintre et al. 2018.
BESIDE_LENS_SHARE = 0.3
FLASH_OFFSET_HALF_SIDES, FLASH_HEIGHT_LOG_DEVIATION, FLASH_BRIGHTNESS_LOG_DEVIATION = 0.24, 0.08, 0.06


def held_places(materials: int, photos: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Draw where hand-held cameras are above a patch, and by how much their measured places are off.

    Args:
        materials, photos: how many patches, and photographs of each.
        rng: draws all random numbers.

    Returns:
        Places and offsets, [materials, photos, 3] each, in half sides of the patch. The first place is straight above
        the patch, at `camera_distance`.
    """
    angle = 2 * math.pi * draw_uniform(rng, materials, photos, 1)
    aside = ASIDE_HALF_SIDES * draw_uniform(rng, materials, photos, 1).sqrt()
    height_share = draw_uniform(rng, materials, photos, 1)
    height = camera_distance() * NEAREST_TIMES * (FARTHEST_TIMES / NEAREST_TIMES) ** height_share
    places = torch.cat([aside * angle.cos(), aside * angle.sin(), height], -1)
    places[:, 0] = places.new_tensor([0.0, 0.0, camera_distance()])
    offsets = PLACE_ERROR * places[..., 2:] * draw_normal(rng, materials, photos, 3)
    return places, offsets
