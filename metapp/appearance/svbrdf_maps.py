"""The maps of a flat material: diffuse and specular colour, roughness and normals, and statistics of them.

All functions take any leading axes (written B), dtype and device.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from metapp.appearance.colour import DISPLAY_GAMMA

STATISTICS_SIDES_PX = (256, 128, 64)  # px a side at which data sets state the statistics of maps


class Maps(NamedTuple):
    """The maps of a flat material; row 0 is the upper edge.

    Attributes:
        diffuse: [B, 3, H, W] linear RGB albedo in [0, 1].
        specular: [B, C, H, W], C = 1 or 3, linear reflectance at normal incidence in [0, 1].
        roughness: [B, 1, H, W] in (0, 1]; GGX's alpha is its square.
        normal: [B, 3, H, W], unit length, z up out of the patch.
    """

    diffuse: Tensor
    specular: Tensor
    roughness: Tensor
    normal: Tensor


def pack_maps(maps: Maps) -> Tensor:
    """Return maps without a leading axis, with 1 or 3 specular channels, as one tensor [10, H, W].

    The channels are the normal, diffuse red, green and blue, roughness, and specular red, green and blue.
    """
    specular = maps.specular.expand(3, -1, -1)
    return torch.cat([maps.normal, maps.diffuse, maps.roughness, specular])


def unpack_maps(maps: Tensor) -> Maps:
    """Return the maps that a tensor [..., 10, H, W] holds; the inverse of :func:`pack_maps`."""
    normal, diffuse, roughness, specular = maps.split((3, 3, 1, 3), -3)
    return Maps(diffuse, specular, roughness, normal)


def map_statistics(maps: Maps) -> Tensor:
    """Compute means and standard deviations of a material's maps over the patch, [B, 2, 6].

    Channels: diffuse red, green and blue and mean specular, each as a display of gamma 2.2 shows it, roughness, and the
    sine of the angle between normal and patch normal.
    """
    specular = maps.specular.mean(-3, keepdim=True)
    display = torch.cat([maps.diffuse, specular], -3).clamp(1e-4, 1) ** (1 / DISPLAY_GAMMA)
    channels = torch.cat([display, maps.roughness, tilt_sine(maps.normal)], -3).flatten(-2)
    return torch.stack([channels.mean(-1), (channels.var(-1, unbiased=False) + 1e-8).sqrt()], -2)


def tilt_sine(normal: Tensor) -> Tensor:
    """Return the sine of the angle between normals [..., 3, H, W] and the patch's normal, [..., 1, H, W].

    It is 0.001 where the angle is 0, which keeps its gradient finite.
    """
    return (normal[..., :2, :, :].square().sum(-3, keepdim=True) + 1e-6).sqrt()


def mean_tilt_degrees(normal: Tensor) -> float:
    """Return the mean angle in degrees between normals [..., 3, H, W] and the patch's normal, to hundredths.

    >>> mean_tilt_degrees(torch.tensor([[0.6, 0.0], [0.0, 0.0], [0.8, 1.0]])[..., None])
    18.43
    """
    across, up = normal.split((2, 1), -3)
    return round(float(torch.atan2(across.norm(dim=-3, keepdim=True), up).rad2deg().mean()), 2)
