"""Where people hold camera and flash, together, for several photographs of one flat material."""

from __future__ import annotations

import math

import torch
from torch import Generator, Tensor

from metapp.appearance.flash import camera_distance
from metapp.learning.draws import normal, uniform

MOST = 9  # photographs of a drawn material
ASIDE = 0.6  # half sides, at most, of all photographs but the first
NEAREST, FARTHEST = (
    0.8,
    2.2,
)  # times the distance at which a camera of 45 degrees sees the patch; a longer lens is farther
# Standard deviation of each coordinate of a measured place, as a share of its height: 1 degree, as of a camera's pose
# from a sheet of markers.
ERROR = 0.02


def held_places(materials: int, photos: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Places [materials, photos, 3] in half sides of the patch, and by how much measured ones are off, of that shape.

    The first is straight above the patch, at `camera_distance`.
    """
    angle = 2 * math.pi * uniform(rng, materials, photos, 1)
    aside = ASIDE * uniform(rng, materials, photos, 1).sqrt()
    share = uniform(rng, materials, photos, 1)
    height = camera_distance() * NEAREST * (FARTHEST / NEAREST) ** share
    places = torch.cat([aside * angle.cos(), aside * angle.sin(), height], -1)
    places[:, 0] = places.new_tensor([0.0, 0.0, camera_distance()])
    off = ERROR * places[..., 2:] * normal(rng, materials, photos, 3)
    return places, off
