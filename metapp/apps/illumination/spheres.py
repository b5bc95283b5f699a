"""Surfaces whose light losses compare, and three spheres by which estimated light is judged.

The spheres are a mirror, matte silver, and gray plastic, by name "diffuse". The protocol is StyleLight's (Wang et al.
2022), which DiffusionLight (Phongthawee et al. 2024) follows: maps are tone-mapped first, then light the spheres, so
that suns count little beside the rest of the map. The materials are taken from DiffusionLight's Blender scenes. In
these scenes the camera sees a perspective from a distance of 16; here it is far away, at +z, as for photographs of
spheres.
"""

from __future__ import annotations

import functools
import math

import torch
from torch import Tensor
from torch.nn.functional import normalize

from metapp.appearance import latlong, reflection
from metapp.appearance.latlong import cosine_transfer, glossy_transfer, sphere_normals
from metapp.appearance.metrics import rgb_angle_degrees, si_rmse
from metapp.appearance.photograph import SphereMaterials, render_material_spheres, render_mirror_spheres
from metapp.appearance.reflection import fresnel_schlick
from metapp.storage.tensor_cache import load_or_compute_tensors

FACING_SURFACES, MIRRORING_SURFACES = 64, 128  # diffuse and glossy surfaces whose light losses compare
SURFACE_ROUGHNESS = 0.35  # roughness of the glossy surfaces

SPHERE_NAMES = ("mirror", "silver", "diffuse")
SPHERE_PX = 64  # side of a sphere's picture
TONE_GAMMA, TONE_MEDIAN = 2.4, 0.5  # exponent of tone mapping, and the value to which the median is brought
METAL_REFLECTANCE = 0.8  # reflectance at normal incidence of mirror and silver
DIFFUSE_ALBEDO, DIFFUSE_SPECULAR = 0.8, 0.04  # albedo of the diffuse sphere, and reflectance of the gloss above it
SPHERE_ROUGHNESSES = {"silver": 0.3271, "diffuse": 0.364}


def sphere_errors(maps: Tensor, target: Tensor) -> dict[str, Tensor]:
    """Measure errors of the spheres' pictures under maps.

    Args:
        maps: linear radiance [T, 3, H, W] at any scale.
        target: true maps [T, 3, H, W] at any scale.

    Returns:
        Of each sphere `<name>_rmse` [T], the scale-invariant root mean square error, where the true map's median is
        0.5; and `<name>_angle` [T], the angle between colours in degrees.
    """
    mask = sphere_normals(SPHERE_PX, device=maps.device)[1]
    errors = {}
    for name, pictures in render_spheres(tone_by_median(torch.cat([maps, target]))).items():
        fit_pictures, true_pictures = pictures.chunk(2)
        errors[f"{name}_rmse"] = si_rmse(fit_pictures, true_pictures, mask)
        errors[f"{name}_angle"] = rgb_angle_degrees(fit_pictures, true_pictures, mask)
    return errors


def tone_by_median(maps: Tensor) -> Tensor:
    """Raise maps [T, 3, H, W] to the power 1 / TONE_GAMMA, and scale the median of values above 0 to TONE_MEDIAN."""
    values = maps.clamp_min(0) ** (1 / TONE_GAMMA)
    median = torch.where(values > 0, values, torch.nan).flatten(1).nanquantile(0.5, 1)
    return values * (TONE_MEDIAN / median.nan_to_num(1))[:, None, None, None]


def render_spheres(maps: Tensor) -> dict[str, Tensor]:
    """Render the spheres under maps [T, 3, H, W] by name: [T, 3, SPHERE_PX, SPHERE_PX], black outside the disc."""
    cosines = sphere_normals(SPHERE_PX, dtype=maps.dtype, device=maps.device)[0][2]
    return {
        "mirror": render_mirror_spheres(maps, SPHERE_PX) * fresnel_schlick(cosines, METAL_REFLECTANCE),
        "silver": _render_sphere(maps, "silver", 0.0, METAL_REFLECTANCE),
        "diffuse": _render_sphere(maps, "diffuse", DIFFUSE_ALBEDO, DIFFUSE_SPECULAR),
    }


def _render_sphere(maps: Tensor, name: str, albedo: float, specular: float) -> Tensor:
    """Render the sphere of a name under maps [T, 3, H, W]: pictures [T, 3, SPHERE_PX, SPHERE_PX]."""
    count = len(maps)
    material = SphereMaterials(
        maps.new_full((count, 3), albedo), maps.new_full((count,), specular), maps.new_ones(count, 1)
    )
    return render_material_spheres(maps, material, SPHERE_PX, (SPHERE_ROUGHNESSES[name],))


@functools.lru_cache(maxsize=4)
def surface_transfer(height: int, width: int, device: torch.device) -> Tensor:
    """Return the transport of light from texels to surfaces, [FACING_SURFACES + MIRRORING_SURFACES, height * width].

    The facing surfaces come first; the directions that surfaces face or mirror are spread evenly.
    """
    name, sources = f"surfaces-{height}x{width}", (__file__, latlong.__file__, reflection.__file__)
    return load_or_compute_tensors(name, sources, lambda: {"sent": _compute_transfer(height, width)})["sent"].to(device)


def _compute_transfer(height: int, width: int) -> Tensor:
    """Compute the matrix of :func:`surface_transfer`."""
    # a surface mirrors a direction to the viewer if its normal lies halfway between
    normals = normalize(_spread_directions(MIRRORING_SURFACES) + torch.tensor([0.0, 0.0, 1.0]), dim=1)
    # few surfaces at a time stay in the processor's cache, which takes a third of the time
    glossy = [glossy_transfer(part, SURFACE_ROUGHNESS, height, width, samples=2) for part in normals.split(8)]
    return torch.cat([cosine_transfer(_spread_directions(FACING_SURFACES), height, width), *glossy])


def _spread_directions(count: int) -> Tensor:
    """Return evenly spread directions [count, 3]: a Fibonacci lattice."""
    i = torch.arange(count) + 0.5
    y, phi = 1 - 2 * i / count, i * (math.pi * (1 + math.sqrt(5)))
    radius = (1 - y * y).sqrt()
    return torch.stack([radius * phi.sin(), y, -radius * phi.cos()], 1)
