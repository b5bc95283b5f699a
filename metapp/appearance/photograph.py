"""Photographs of spheres of some material, lit by lat-long maps, through some camera.

They are what illumination is inferred from, drawn for training and rendered to judge. A sphere touches its picture's
border, is seen from +z, and is lit by the map alone. Everything has a leading axis of T photographs.
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

GLOSS_ROUGHNESSES = (0.15, 0.19, 0.25, 0.32, 0.42, 0.54, 0.7)  # each needs its own transfer matrix
MIRROR_SAMPLES_PER_SIDE = 4  # samples along each side of a pixel of a mirror's picture
# rows of the map times px of the picture's side: from this product on lobes take a tenth of a second or more to
# compute, and are kept on disk
MIN_CACHED_ROWS_TIMES_PX = 64 * 64
_CHUNK_PX = 16  # pixels at a time: a lobe is sampled in up to 32,768 directions, which then stay in the CPU's cache


class SphereMaterials(NamedTuple):
    """The materials of spheres: a diffuse body under a gloss.

    Attributes:
        albedo: albedo of the body, linear RGB [T, 3].
        specular: reflectance F0 of the gloss at normal incidence (Schlick), [T]; 0 is no gloss.
        gloss_weights: mixture weights of the gloss over roughnesses, [T, R]; each row sums to 1.
    """

    albedo: Tensor
    specular: Tensor
    gloss_weights: Tensor


class CameraCurves(NamedTuple):
    """The curves of cameras, from radiance to display values.

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
    """Photograph spheres of random materials, each under a map, by random cameras.

    Args:
        maps: [T, 3, H, W] linear Rec.709 radiance, >= 0; its scale does not matter.
        rng: draws materials and cameras.
        size: side of the pictures, an even number of px.

    Returns:
        Display values in [0, 1], [T, 3, size, size]; black outside the disc.
    """
    drawn = draw_uniform(rng, len(maps), 11).to(maps)
    materials = draw_sphere_materials(drawn[:, :8])
    roughness_indices = materials.gloss_weights.argmax(1)
    radiance = maps.new_zeros(len(maps), 3, size, size)
    for index in roughness_indices.unique().tolist():
        rows = (roughness_indices == index).nonzero()[:, 0]
        selected_materials = SphereMaterials(
            materials.albedo[rows], materials.specular[rows], maps.new_ones(len(rows), 1)
        )
        radiance[rows] = render_material_spheres(
            maps[rows], selected_materials, size, GLOSS_ROUGHNESSES[index : index + 1]
        )
    return develop(radiance, draw_camera_curves(drawn[:, 8:], radiance)).clamp_max(1)


def draw_sphere_materials(drawn: Tensor) -> SphereMaterials:
    """Draw a body of albedo 0.3 to 0.95, mostly nearly gray; on three of four a gloss of up to 0.6, smooth to rough.

    Args:
        drawn: uniform in [0, 1), [T, 8].
    """
    tint = 1 - 0.5 * drawn[:, :1] ** 2 * drawn[:, 1:4]
    albedo = ((0.3 + 0.65 * drawn[:, 4:5]) * tint / tint.amax(1, keepdim=True)).clamp_min(0.3)
    specular = torch.where(drawn[:, 5] < 0.75, 0.6 * drawn[:, 6], 0.0)
    roughness_index = (drawn[:, 7] * len(GLOSS_ROUGHNESSES)).long()
    return SphereMaterials(
        albedo, specular, torch.nn.functional.one_hot(roughness_index, len(GLOSS_ROUGHNESSES)).to(drawn)
    )


def draw_camera_curves(drawn: Tensor, radiance: Tensor) -> CameraCurves:
    """Draw a curve around sRGB's, exposed such that most of the sphere is seen while suns clip.

    Args:
        drawn: uniform in [0, 1), [T, 3].
        radiance: radiance of the spheres, [T, 3, S, S].
    """
    gamma, contrast = torch.exp((2 * drawn[:, 1] - 1) * math.log(1.25)), 0.5 * drawn[:, 2]
    return CameraCurves(exposures(radiance, 0.4 + 0.5 * drawn[:, 0]), gamma, contrast)


def exposures(radiance: Tensor, level: Tensor) -> Tensor:
    """Compute exposures [T] that give the 90th percentile of each sphere's luminance a display value, by sRGB's curve.

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
    """Render the radiance [T, 3, size, size] of spheres under maps; 0 outside the disc.

    Args:
        maps: linear radiance, [T, 3, H, W].
        material: material of each sphere; the weights of its gloss are for these roughnesses.
        size: side of the pictures, an even number of px.
        roughnesses: roughnesses that glosses mix; each costs a product with a matrix.
    """
    normals, mask = sphere_normals(size, dtype=maps.dtype, device=maps.device)
    body = _render_by_transfer(_diffuse_transfer(size), maps) * material.albedo[..., None, None]
    lobes = torch.stack(
        [_render_by_transfer(_load_glossy_transfer(size, roughness), maps) for roughness in roughnesses], 1
    )
    gloss = (lobes * material.gloss_weights[..., None, None, None]).sum(1)
    specular = material.specular[:, None, None, None]
    fresnel = specular + (specular > 0) * (1 - specular) * (1 - normals[2]) ** 5
    return torch.lerp(body, gloss, fresnel.expand_as(body)) * mask


def render_mirror_spheres(maps: Tensor, size: int) -> Tensor:
    """Render the radiance [T, 3, size, size] of perfect mirror spheres under maps; 0 outside the disc.

    Args:
        maps: linear radiance, [T, 3, H, W].
        size: side of the pictures, px.
    """
    texels, mask = (
        tensor.to(maps.device) for tensor in _mirrored_texels(size * MIRROR_SAMPLES_PER_SIDE, *maps.shape[-2:])
    )
    mirrored = maps.flatten(2)[..., texels.flatten()].unflatten(2, texels.shape) * mask
    shares = avg_pool2d(mask[None].to(maps), MIRROR_SAMPLES_PER_SIDE).clamp_min(0.5)
    return avg_pool2d(mirrored, MIRROR_SAMPLES_PER_SIDE) / shares * sphere_normals(size, device=maps.device)[1]


def develop(radiance: Tensor, camera: CameraCurves) -> Tensor:
    """Develop radiance to display values by a camera's curve, both [T, 3, S, S].

    The result is in [0, 1], and rises above 1 where a sensor would clip.
    """
    exposure, gamma, contrast = (parameter[:, None, None, None] for parameter in camera)
    linear = radiance * exposure
    display = linear_to_srgb(linear.clamp(0, 1)).clamp_min(0)
    # a power has no derivative at 0
    display = torch.where(display > 0, display.clamp_min(1e-6) ** gamma, 0.0)
    curved = display + contrast * (display * display * (3 - 2 * display) - display)
    return curved + (linear - 1).clamp_min(0)


def _render_by_transfer(transfer: Tensor, maps: Tensor) -> Tensor:
    """Render pictures [T, 3, S, S] of spheres under maps, by the transfer matrix of their upper right quarter.

    The other quarters are that quarter under mirrored maps.

    Args:
        transfer: [(S / 2)^2, 2 n^2], n rows of a map of 2 n columns.
        maps: linear radiance, [T, 3, H, W].
    """
    rows, half = math.isqrt(transfer.shape[1] // 2), math.isqrt(transfer.shape[0])
    resampled = resample_maps(maps, rows, 2 * rows) if maps.shape[-2:] != (rows, 2 * rows) else maps
    upright_and_flipped = torch.stack([resampled, resampled.flip(-2)])
    # [right or left, upper or lower, T, 3, 2 n^2]
    mirrored = torch.stack([upright_and_flipped, upright_and_flipped.flip(-1)]).flatten(-2)
    right, left = (mirrored @ transfer.to(maps).T).unflatten(-1, (half, half))
    upper, lower = torch.cat([left.flip(-1), right], dim=-1)
    return torch.cat([upper, lower.flip(-2)], dim=-2)


@functools.lru_cache(maxsize=8)
def _mirrored_texels(size: int, height: int, width: int) -> tuple[Tensor, Tensor]:
    """Return the index of the texel that each pixel [size, size] of a mirror sphere shows, and the sphere's mask."""
    normals, mask = sphere_normals(size, dtype=torch.float64)
    return texel_index(
        2 * normals[2] * normals - normals.new_tensor([0.0, 0.0, 1.0])[:, None, None], height, width
    ), mask


def _quarter_normals(size: int) -> Tensor:
    """Return normals [(size / 2)^2, 3] of the upper right quarter of the picture."""
    if size % 2:
        raise ValueError(f"size of a sphere's picture: {size} px, expected an even number")
    return sphere_normals(size)[0][:, : size // 2, size // 2 :].flatten(1).T


@functools.cache
def _diffuse_transfer(size: int) -> Tensor:
    """Return the transfer matrix of a diffuse sphere's upper right quarter, from maps of 16 x 32 texels."""
    return cosine_transfer(_quarter_normals(size), 16, 32)


@functools.cache
def _load_glossy_transfer(size: int, roughness: float) -> Tensor:
    """Return the transfer matrix of a glossy sphere's upper right quarter; large ones come from the cache on disk."""
    rows = 64 if roughness < 0.22 else 32 if roughness < 0.5 else 16
    samples = math.ceil(math.pi / 2 / rows / roughness**2)

    def make() -> dict[str, Tensor]:
        parts = _quarter_normals(size).split(_CHUNK_PX)
        lobes = [glossy_transfer(part, roughness, rows, 2 * rows, samples=samples) for part in parts]
        return {"lobes": torch.cat(lobes)}

    if rows * size < MIN_CACHED_ROWS_TIMES_PX:
        return make()["lobes"]
    sources = (__file__, latlong.__file__, reflection.__file__)
    return load_or_compute_tensors(f"lobes-{size}-{roughness:g}", sources, make)["lobes"]
