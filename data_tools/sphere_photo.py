"""Photographs of spheres: what a lat-long map looks like on a ball of some material, through some camera.

The sphere touches the picture's border, is seen from +z, and is lit by the map alone; nothing is around it.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import torch
from torch import Tensor

from data_tools.patterns import Rng, between, chance, log_between, pick
from metapp.colour import linear_to_srgb, srgb_to_linear
from metapp.latlong import cosine_transfer, glossy_transfer, luminance, resample, sphere_normals

SIZE = 64  # px
COUNT = 4  # photographs of a map
ROUGHNESSES = (0.15, 0.19, 0.25, 0.32, 0.42, 0.54, 0.7)  # each needs a matrix of its own

_CHUNK = 16  # pixels at a time: a lobe is looked at in up to 32,768 directions, which then stay in the cache


class Material(NamedTuple):
    """What a sphere is made of.

    Attributes:
        albedo: of the diffuse body, linear RGB [3].
        specular: share of the light that a gloss on top takes, seen from straight above; it rises to all at the rim
            (Schlick). 0 is no gloss.
        roughness: of the gloss, one of `ROUGHNESSES`.
    """

    albedo: Tensor
    specular: float
    roughness: float


class Camera(NamedTuple):
    """How light becomes display values.

    Attributes:
        level: display value, by sRGB's curve, of the 90th percentile of the sphere's luminance.
        gamma: power of sRGB's display values.
        contrast: share of an S-curve after that.
    """

    level: float
    gamma: float
    contrast: float


@torch.no_grad()
def photograph(light: Tensor, rng: Rng, *, count: int = COUNT, size: int = SIZE) -> Tensor:
    """Photographs of spheres of random materials under a map, by random cameras.

    Args:
        light: the map, [3, H, W] linear Rec.709 radiance, >= 0; its scale does not matter.
        rng: of materials and cameras.
        count: how many.
        size: side of the pictures, an even number of px.

    Returns:
        Display values, uint8 [count, 3, size, size]; black outside the disc.
    """
    photos = [expose(shade(light, draw_material(rng), size), draw_camera(rng)) for _ in range(count)]
    return (torch.stack(photos) * 255).round().to(torch.uint8)


def draw_material(rng: Rng) -> Material:
    """A body of albedo 0.3 to 0.95, mostly nearly gray; on three of four a gloss of up to 0.6, smooth to rough."""
    strength = float(rng.random()) ** 2
    tint = torch.tensor([1 - 0.5 * strength * float(rng.random()) for _ in range(3)])
    albedo = (between(rng, 0.3, 0.95) * tint / tint.max()).clamp_min(0.3)
    specular = between(rng, 0.0, 0.6) if chance(rng, 0.75) else 0.0
    return Material(albedo, specular, pick(rng, ROUGHNESSES))


def draw_camera(rng: Rng) -> Camera:
    """A curve around sRGB's, exposed for most of the sphere to be seen while suns clip."""
    return Camera(between(rng, 0.4, 0.9), log_between(rng, 0.8, 1.25), between(rng, 0.0, 0.5))


def shade(light: Tensor, material: Material, size: int = SIZE) -> Tensor:
    """Radiance [3, size, size] of a sphere under a map [3, H, W]; 0 outside the disc."""
    normals, mask = sphere_normals(size)
    body = _lit(_diffuse(size), light) * material.albedo[:, None, None]
    if material.specular == 0:
        return body * mask
    fresnel = material.specular + (1 - material.specular) * (1 - normals[2]) ** 5
    return ((1 - fresnel) * body + fresnel * _lit(_glossy(size, material.roughness), light)) * mask


def expose(radiance: Tensor, camera: Camera) -> Tensor:
    """Display values in [0, 1] of a sphere's radiance, both [3, size, size]."""
    seen = luminance(radiance)[sphere_normals(radiance.shape[-1])[1]]
    # Where less than a tenth of the sphere is lit, a tenth of the mean counts instead.
    level = torch.maximum(seen.quantile(0.9), seen.mean() / 10).clamp_min(torch.finfo(seen.dtype).tiny)
    exposure = srgb_to_linear(seen.new_tensor(camera.level)) / level
    display = linear_to_srgb((radiance * exposure).clamp(0, 1)) ** camera.gamma
    return display + camera.contrast * (display * display * (3 - 2 * display) - display)


def _lit(transfer: Tensor, light: Tensor) -> Tensor:
    """A picture [3, S, S] of what a map [3, H, W] becomes by the matrix [(S / 2)^2, 2 n^2] of the upper right quarter.

    Mirrored pixels see what that quarter sees of the mirrored map.
    """
    rows, half = math.isqrt(transfer.shape[1] // 2), math.isqrt(transfer.shape[0])
    upright = resample(light, rows, 2 * rows)
    both = torch.stack([upright, upright.flip(-2)])
    maps = torch.stack([both, both.flip(-1)]).flatten(-2)  # [right or left, upper or lower, 3, 2 n^2]
    right, left = (maps @ transfer.T).unflatten(-1, (half, half))
    upper, lower = torch.cat([left.flip(-1), right], dim=-1)
    return torch.cat([upper, lower.flip(-2)], dim=-2)


def _quarter(size: int) -> Tensor:
    """Normals [(size / 2)^2, 3] of the upper right quarter of the picture."""
    if size % 2:
        raise ValueError(f"size of a sphere's picture: {size} px, expected an even number")
    return sphere_normals(size)[0][:, : size // 2, size // 2 :].flatten(1).T


@functools.cache
def _diffuse(size: int) -> Tensor:
    return cosine_transfer(_quarter(size), 16, 32)


@functools.cache
def _glossy(size: int, roughness: float) -> Tensor:
    rows = 64 if roughness < 0.22 else 32 if roughness < 0.5 else 16
    samples = math.ceil(math.pi / 2 / rows / roughness**2)
    parts = _quarter(size).split(_CHUNK)
    return torch.cat([glossy_transfer(part, roughness, rows, 2 * rows, samples=samples) for part in parts])
