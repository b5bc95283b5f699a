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
from metapp.appearance.metrics import rgb_angle, si_rmse
from metapp.appearance.photograph import Material, mirror, shade
from metapp.appearance.reflection import fresnel_schlick
from metapp.storage.tensor_cache import cached_tensors

FACED, MIRRORED, SHINE = 64, 128, 0.35  # surfaces that the loss looks at: diffuse, glossy and how rough

SPHERES = ("mirror", "silver", "diffuse")
SPHERE_PX = 64  # px
GAMMA, MEDIAN = 2.4, 0.5  # of tone mapping
METAL = 0.8  # reflectance at normal incidence, of mirror and silver
ALBEDO, SPECULAR = 0.8, 0.04  # of the diffuse one, under a gloss
ROUGHNESSES = {"silver": 0.3271, "diffuse": 0.364}


def sphere_errors(maps: Tensor, target: Tensor) -> dict[str, Tensor]:
    """Errors [T] of the spheres under maps, both [T, 3, H, W], linear radiance at any scale.

    Returns:
        Of each sphere `<name>_rmse`, scale-invariant, where the true map's median is 0.5; and `<name>_angle`, degrees.
    """
    mask = sphere_normals(SPHERE_PX, device=maps.device)[1]
    errors = {}
    for name, pictures in lit_spheres(toned(torch.cat([maps, target]))).items():
        fitted, wanted = pictures.chunk(2)
        errors[f"{name}_rmse"] = si_rmse(fitted, wanted, mask)
        errors[f"{name}_angle"] = rgb_angle(fitted, wanted, mask)
    return errors


def toned(maps: Tensor) -> Tensor:
    """Maps [T, 3, H, W] to the power of 1 / GAMMA, the median of all values above 0 brought to MEDIAN."""
    values = maps.clamp_min(0) ** (1 / GAMMA)
    middle = torch.where(values > 0, values, torch.nan).flatten(1).nanquantile(0.5, 1)
    return values * (MEDIAN / middle.nan_to_num(1))[:, None, None, None]


def lit_spheres(maps: Tensor) -> dict[str, Tensor]:
    """Pictures [T, 3, SPHERE_PX, SPHERE_PX] of the spheres under maps [T, 3, H, W], by name; black outside the disc."""
    cosines = sphere_normals(SPHERE_PX, dtype=maps.dtype, device=maps.device)[0][2]
    return {
        "mirror": mirror(maps, SPHERE_PX) * fresnel_schlick(cosines, METAL),
        "silver": _shaded(maps, "silver", 0.0, METAL),
        "diffuse": _shaded(maps, "diffuse", ALBEDO, SPECULAR),
    }


def _shaded(maps: Tensor, name: str, albedo: float, specular: float) -> Tensor:
    count = len(maps)
    material = Material(maps.new_full((count, 3), albedo), maps.new_full((count,), specular), maps.new_ones(count, 1))
    return shade(maps, material, SPHERE_PX, (ROUGHNESSES[name],))


@functools.lru_cache(maxsize=4)
def surfaces(height: int, width: int, device: torch.device) -> Tensor:
    """Transport of light to surfaces [FACED + MIRRORED, height * width], evenly spread: facing, then mirroring."""
    name, sources = f"surfaces-{height}x{width}", (__file__, latlong.__file__, reflection.__file__)
    return cached_tensors(name, sources, lambda: {"sent": _surfaces(height, width)})["sent"].to(device)


def _surfaces(height: int, width: int) -> Tensor:
    middle = normalize(_spread(MIRRORED) + torch.tensor([0.0, 0.0, 1.0]), dim=1)  # between them and the viewer
    # a few at a time stay near the processor, a third of the time
    glossy = [glossy_transfer(each, SHINE, height, width, samples=2) for each in middle.split(8)]
    return torch.cat([cosine_transfer(_spread(FACED), height, width), *glossy])


def _spread(count: int) -> Tensor:
    """Evenly spread directions [count, 3]: a Fibonacci lattice."""
    i = torch.arange(count) + 0.5
    y, phi = 1 - 2 * i / count, i * (math.pi * (1 + math.sqrt(5)))
    radius = (1 - y * y).sqrt()
    return torch.stack([radius * phi.sin(), y, -radius * phi.cos()], 1)
