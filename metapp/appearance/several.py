"""Where people hold camera and flash, together, for several photographs of one flat material."""

from __future__ import annotations

import math

import torch
from torch import Generator, Tensor

from metapp.appearance.flash import camera_distance

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
    device = rng.device
    angle = 2 * math.pi * torch.rand(materials, photos, 1, generator=rng, device=device)
    aside = ASIDE * torch.rand(materials, photos, 1, generator=rng, device=device).sqrt()
    share = torch.rand(materials, photos, 1, generator=rng, device=device)
    height = camera_distance() * NEAREST * (FARTHEST / NEAREST) ** share
    places = torch.cat([aside * angle.cos(), aside * angle.sin(), height], -1)
    places[:, 0] = places.new_tensor([0.0, 0.0, camera_distance()])
    off = ERROR * places[..., 2:] * torch.randn(materials, photos, 3, generator=rng, device=device)
    return places, off
