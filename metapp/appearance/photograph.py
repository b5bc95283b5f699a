"""Photographs of spheres of some material, lit by lat-long maps, through some camera.

A sphere touches its picture's border, is seen from +z, and is lit by the map alone. Everything has a leading axis of T
photographs.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d

from metapp.appearance import latlong, reflection
from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.latlong import (
    cosine_transfer,
    glossy_transfer,
    luminance,
    resample_maps,
    sphere_normals,
    texel_index,
)
from metapp.learning.random_tensors import draw_uniform
from metapp.storage.tensor_cache import load_or_compute_tensors

GLOSS_ROUGHNESSES = (0.15, 0.19, 0.25, 0.32, 0.42, 0.54, 0.7)  # each needs a matrix of its own
MIRROR_SAMPLES_PER_SIDE = 4  # of a mirror's pixel along each side
MIN_CACHED_ROWS_TIMES_PX = (
    64 * 64
)  # rows times px from which lobes take a tenth of a second or more: these are kept on disk
_CHUNK = 16  # pixels at a time: a lobe is sampled in up to 32,768 directions, which then stay in the CPU's cache


class SphereMaterials(NamedTuple):
    """Materials of spheres: a diffuse body under a gloss.

    Attributes:
        albedo: of the body, linear RGB [T, 3].
        specular: reflectance F0 of the gloss at normal incidence (Schlick), [T]; 0 is no gloss.
        gloss: mixture weights of the gloss over roughnesses, [T, R]; each row sums to 1.
    """

    albedo: Tensor
    specular: Tensor
    gloss: Tensor


class CameraCurves(NamedTuple):
    """The curve from radiance to display values.

    Attributes:
        exposure: linear value of radiance 1, [T].
        gamma: power of sRGB's display values, [T].
        contrast: share of an S-curve after that, [T].
    """

    exposure: Tensor
    gamma: Tensor
    contrast: Tensor


@torch.no_grad()
def photograph_spheres(maps: Tensor, rng: Generator, size: int = 64) -> Tensor:
    """Photographs of spheres of random materials, each under a map, by random cameras.

    Args:
        maps: [T, 3, H, W] linear Rec.709 radiance, >= 0; its scale does not matter.
        rng: of materials and cameras.
        size: side of the pictures, an even number of px.

    Returns:
        Display values in [0, 1], [T, 3, size, size]; black outside the disc.
    """
    drawn = draw_uniform(rng, len(maps), 11).to(maps)
    materials = draw_sphere_materials(drawn[:, :8])
    kinds = materials.gloss.argmax(1)
    radiance = maps.new_zeros(len(maps), 3, size, size)
    for kind in kinds.unique().tolist():
        rows = (kinds == kind).nonzero()[:, 0]
        some = SphereMaterials(materials.albedo[rows], materials.specular[rows], maps.new_ones(len(rows), 1))
        radiance[rows] = render_material_spheres(maps[rows], some, size, GLOSS_ROUGHNESSES[kind : kind + 1])
    return develop(radiance, draw_camera_curves(drawn[:, 8:], radiance)).clamp_max(1)


def draw_sphere_materials(drawn: Tensor) -> SphereMaterials:
    """A body of albedo 0.3 to 0.95, mostly nearly gray; on three of four a gloss of up to 0.6, smooth to rough.

    Args:
        drawn: uniform in [0, 1), [T, 8].
    """
    tint = 1 - 0.5 * drawn[:, :1] ** 2 * drawn[:, 1:4]
    albedo = ((0.3 + 0.65 * drawn[:, 4:5]) * tint / tint.amax(1, keepdim=True)).clamp_min(0.3)
    specular = torch.where(drawn[:, 5] < 0.75, 0.6 * drawn[:, 6], 0.0)
    kind = (drawn[:, 7] * len(GLOSS_ROUGHNESSES)).long()
    return SphereMaterials(albedo, specular, torch.nn.functional.one_hot(kind, len(GLOSS_ROUGHNESSES)).to(drawn))


def draw_camera_curves(drawn: Tensor, radiance: Tensor) -> CameraCurves:
    """A curve around sRGB's, exposed for most of the sphere to be seen while suns clip.

    Args:
        drawn: uniform in [0, 1), [T, 3].
        radiance: of the spheres, [T, 3, S, S].
    """
    gamma, contrast = torch.exp((2 * drawn[:, 1] - 1) * math.log(1.25)), 0.5 * drawn[:, 2]
    return CameraCurves(exposures(radiance, 0.4 + 0.5 * drawn[:, 0]), gamma, contrast)


def exposures(radiance: Tensor, level: Tensor) -> Tensor:
    """Exposures [T] by which the 90th percentile of each sphere's luminance has a display value, by sRGB's curve.

    Args:
        radiance: [T, 3, S, S].
        level: the display values, [T].
    """
    pixels = luminance(radiance)[:, sphere_normals(radiance.shape[-1], device=radiance.device)[1]]
    # where less than a tenth of the sphere is lit, a tenth of the mean counts instead
    bright = torch.maximum(pixels.quantile(0.9, 1), pixels.mean(1) / 10).clamp_min(torch.finfo(pixels.dtype).tiny)
    return srgb_to_linear(level) / bright


def render_material_spheres(
    maps: Tensor, material: SphereMaterials, size: int, roughnesses: Sequence[float] = GLOSS_ROUGHNESSES
) -> Tensor:
    """Radiance [T, 3, size, size] of spheres under maps [T, 3, H, W]; 0 outside the disc.

    Args:
        maps: linear radiance.
        material: of each sphere; the parts of its gloss are of these roughnesses.
        size: side of the pictures, an even number of px.
        roughnesses: each costs a product with a matrix.
    """
    normals, mask = sphere_normals(size, dtype=maps.dtype, device=maps.device)
    body = _lit(_diffuse(size), maps) * material.albedo[..., None, None]
    lobes = torch.stack([_lit(_glossy(size, roughness), maps) for roughness in roughnesses], 1)
    gloss = (lobes * material.gloss[..., None, None, None]).sum(1)
    specular = material.specular[:, None, None, None]
    fresnel = specular + (specular > 0) * (1 - specular) * (1 - normals[2]) ** 5
    return torch.lerp(body, gloss, fresnel.expand_as(body)) * mask


def render_mirror_spheres(maps: Tensor, size: int) -> Tensor:
    """Radiance [T, 3, size, size] of perfect mirror spheres under maps [T, 3, H, W]; 0 outside the disc.

    Args:
        maps: linear radiance.
        size: side of the pictures, px.
    """
    texels, mask = (part.to(maps.device) for part in _mirrored(size * MIRROR_SAMPLES_PER_SIDE, *maps.shape[-2:]))
    seen = maps.flatten(2)[..., texels.flatten()].unflatten(2, texels.shape) * mask
    shares = avg_pool2d(mask[None].to(maps), MIRROR_SAMPLES_PER_SIDE).clamp_min(0.5)
    return avg_pool2d(seen, MIRROR_SAMPLES_PER_SIDE) / shares * sphere_normals(size, device=maps.device)[1]


def develop(radiance: Tensor, camera: CameraCurves) -> Tensor:
    """Display values of radiance, both [T, 3, S, S]: in [0, 1], and rising above 1 if a sensor would clip."""
    exposure, gamma, contrast = (parameter[:, None, None, None] for parameter in camera)
    linear = radiance * exposure
    display = linear_to_srgb(linear.clamp(0, 1)).clamp_min(0)
    # a power has no derivative at 0
    display = torch.where(display > 0, display.clamp_min(1e-6) ** gamma, 0.0)
    curved = display + contrast * (display * display * (3 - 2 * display) - display)
    return curved + (linear - 1).clamp_min(0)


def _lit(transfer: Tensor, maps: Tensor) -> Tensor:
    """Pictures [T, 3, S, S] of spheres under maps, by the transfer matrix [(S / 2)^2, 2 n^2] of their upper right.

    The other quarters are that one under mirrored maps.
    """
    rows, half = math.isqrt(transfer.shape[1] // 2), math.isqrt(transfer.shape[0])
    upright = resample_maps(maps, rows, 2 * rows) if maps.shape[-2:] != (rows, 2 * rows) else maps
    both = torch.stack([upright, upright.flip(-2)])
    mirrored = torch.stack([both, both.flip(-1)]).flatten(-2)  # [right or left, upper or lower, T, 3, 2 n^2]
    right, left = (mirrored @ transfer.to(maps).T).unflatten(-1, (half, half))
    upper, lower = torch.cat([left.flip(-1), right], dim=-1)
    return torch.cat([upper, lower.flip(-2)], dim=-2)


@functools.lru_cache(maxsize=8)
def _mirrored(size: int, height: int, width: int) -> tuple[Tensor, Tensor]:
    """Which texels pixels [size, size] of a mirror sphere show, and which of them are on it."""
    normals, mask = sphere_normals(size, dtype=torch.float64)
    return texel_index(
        2 * normals[2] * normals - normals.new_tensor([0.0, 0.0, 1.0])[:, None, None], height, width
    ), mask


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

    def make() -> dict[str, Tensor]:
        parts = _quarter(size).split(_CHUNK)
        lobes = [glossy_transfer(part, roughness, rows, 2 * rows, samples=samples) for part in parts]
        return {"lobes": torch.cat(lobes)}

    if rows * size < MIN_CACHED_ROWS_TIMES_PX:
        return make()["lobes"]
    sources = (__file__, latlong.__file__, reflection.__file__)
    return load_or_compute_tensors(f"lobes-{size}-{roughness:g}", sources, make)["lobes"]
