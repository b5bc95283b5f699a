"""Points of spheres that losses compare the light of, and three spheres by which estimated light is judged.

These are a mirror, matte silver, and gray plastic, by name "diffuse". The protocol is that of StyleLight (Wang et al.
2022), which DiffusionLight (Phongthawee et al. 2024) follows: maps are tone-mapped first, then light the spheres, so
that suns count little beside the rest of the map. The materials are those of its Blender scenes. There the camera is 16
away and sees a perspective; here it is far away, at +z, as where photographs are taken from.
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

FACING_SURFACES, MIRRORING_SURFACES, SURFACE_ROUGHNESS = (
    64,
    128,
    0.35,
)  # surfaces that the loss looks at: diffuse, glossy and how rough

SPHERE_NAMES = ("mirror", "silver", "diffuse")
SPHERE_PX = 64  # px
TONE_GAMMA, TONE_MEDIAN = 2.4, 0.5  # of tone mapping
METAL_REFLECTANCE = 0.8  # reflectance at normal incidence, of mirror and silver
DIFFUSE_ALBEDO, DIFFUSE_SPECULAR = 0.8, 0.04  # of the diffuse one, under a gloss
SPHERE_ROUGHNESSES = {"silver": 0.3271, "diffuse": 0.364}


def sphere_errors(maps: Tensor, target: Tensor) -> dict[str, Tensor]:
    """Errors [T] of the spheres under maps, both [T, 3, H, W], linear radiance at any scale.

    Returns:
        Of each sphere `<name>_rmse`, scale-invariant, where the true map's median is 0.5; and `<name>_angle`, degrees.
    """
    mask = sphere_normals(SPHERE_PX, device=maps.device)[1]
    errors = {}
    for name, pictures in render_spheres(tone_by_median(torch.cat([maps, target]))).items():
        fitted, wanted = pictures.chunk(2)
        errors[f"{name}_rmse"] = si_rmse(fitted, wanted, mask)
        errors[f"{name}_angle"] = rgb_angle_degrees(fitted, wanted, mask)
    return errors


def tone_by_median(maps: Tensor) -> Tensor:
    """Maps [T, 3, H, W] to the power of 1 / GAMMA, the median of all values above 0 brought to MEDIAN."""
    values = maps.clamp_min(0) ** (1 / TONE_GAMMA)
    middle = torch.where(values > 0, values, torch.nan).flatten(1).nanquantile(0.5, 1)
    return values * (TONE_MEDIAN / middle.nan_to_num(1))[:, None, None, None]


def render_spheres(maps: Tensor) -> dict[str, Tensor]:
    """Pictures [T, 3, SPHERE_PX, SPHERE_PX] of the spheres under maps [T, 3, H, W], by name; black outside the disc."""
    cosines = sphere_normals(SPHERE_PX, dtype=maps.dtype, device=maps.device)[0][2]
    return {
        "mirror": render_mirror_spheres(maps, SPHERE_PX) * fresnel_schlick(cosines, METAL_REFLECTANCE),
        "silver": _shaded(maps, "silver", 0.0, METAL_REFLECTANCE),
        "diffuse": _shaded(maps, "diffuse", DIFFUSE_ALBEDO, DIFFUSE_SPECULAR),
    }


def _shaded(maps: Tensor, name: str, albedo: float, specular: float) -> Tensor:
    count = len(maps)
    material = SphereMaterials(
        maps.new_full((count, 3), albedo), maps.new_full((count,), specular), maps.new_ones(count, 1)
    )
    return render_material_spheres(maps, material, SPHERE_PX, (SPHERE_ROUGHNESSES[name],))


@functools.lru_cache(maxsize=4)
def surface_transfer(height: int, width: int, device: torch.device) -> Tensor:
    """Transport of light to surfaces [FACED + MIRRORED, height * width], evenly spread: facing, then mirroring."""
    name, sources = f"surfaces-{height}x{width}", (__file__, latlong.__file__, reflection.__file__)
    return load_or_compute_tensors(name, sources, lambda: {"sent": _surfaces(height, width)})["sent"].to(device)


def _surfaces(height: int, width: int) -> Tensor:
    middle = normalize(
        _spread(MIRRORING_SURFACES) + torch.tensor([0.0, 0.0, 1.0]), dim=1
    )  # between them and the viewer
    # a few at a time stay near the processor, a third of the time
    glossy = [glossy_transfer(each, SURFACE_ROUGHNESS, height, width, samples=2) for each in middle.split(8)]
    return torch.cat([cosine_transfer(_spread(FACING_SURFACES), height, width), *glossy])


def _spread(count: int) -> Tensor:
    """Evenly spread directions [count, 3]: a Fibonacci lattice."""
    i = torch.arange(count) + 0.5
    y, phi = 1 - 2 * i / count, i * (math.pi * (1 + math.sqrt(5)))
    radius = (1 - y * y).sqrt()
    return torch.stack([radius * phi.sin(), y, -radius * phi.cos()], 1)
