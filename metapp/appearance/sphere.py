"""A lit sphere, the picture of a BRDF.

All sphere pictures of BRDFs, of fits and references alike, come from the scenes here: pairs of pixel and light, to be
multiplied with reflectance.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from metapp.appearance import geometry
from metapp.appearance.geometry import directions_to_four_angles, directions_to_full_rusinkiewicz, gauss_legendre
from metapp.storage.tensor_cache import load_or_compute_tensors


class SphereScene(NamedTuple):
    """A lit sphere seen by an orthographic camera, as (pixel, light) pairs to multiply with a BRDF.

    Attributes:
        mask: [size, size] bool, the pixels that the sphere touches; P of them, in row-major order.
        coverage: [size, size] in [0, 1], the share of the pixel that the sphere covers.
        angles: [P, L, 3] in rad, half and difference angles of light (wi) and camera (wo) at the pixel's point;
            [P, L, 4] with phi_h, from a tangent that lies horizontally.
        weights: [P, L, 3] linear RGB, radiance * cosine * solid angle; zero for lights below the horizon.
    """

    mask: Tensor
    coverage: Tensor
    angles: Tensor
    weights: Tensor


def _softbox(centre: tuple[float, float, float], size_rad: tuple[float, float], grid: tuple[int, int]) -> Tensor:
    """Return the directions [A * B, 3] of the lamps of a softbox, a grid of A times B.

    Args:
        centre: direction of its centre.
        size_rad: its width and height in rad.
        grid: A and B, numbers of lamps across and along.
    """
    forward = torch.nn.functional.normalize(torch.tensor(centre, dtype=torch.float64), dim=0)
    right = torch.nn.functional.normalize(torch.linalg.cross(forward.new_tensor([0.0, 1.0, 0.0]), forward), dim=0)
    across, along = (
        ((torch.arange(count, dtype=torch.float64) + 0.5) / count - 0.5) * extent
        for count, extent in zip(grid, size_rad, strict=True)
    )
    tangent = across.tan()[:, None, None] * right + along.tan()[:, None] * torch.linalg.cross(forward, right)
    return torch.nn.functional.normalize((forward + tangent).reshape(-1, 3), dim=-1)


def _studio_lights() -> tuple[Tensor, Tensor]:
    """Return the lights of the reference picture but for its sky.

    Returns:
        Directions [L, 3] (x right, y up, z to the camera) and their linear RGB irradiance [L, 3] across the beam.
    """
    lights = [  # directions, linear RGB tint, irradiance
        (_softbox((-0.55, 0.6, 0.75), (0.45, 0.45), (6, 6)), (1.0, 0.95, 0.88), 1.0),  # key
        (_softbox((0.95, 0.05, 0.45), (0.2, 0.7), (2, 8)), (0.84, 0.93, 1.0), 0.35),  # fill
        (_softbox((0.35, 0.75, -0.6), (0.6, 0.1), (8, 1)), (1.0, 1.0, 1.0), 0.4),  # rim, from behind
        (torch.tensor([[0.36, 0.48, 0.8]], dtype=torch.float64), (1.0, 0.98, 0.95), 0.2),  # lamp: shows highlights
    ]
    power = [torch.tensor(tint, dtype=torch.float64).mul(p / len(d)).expand(len(d), 3) for d, tint, p in lights]
    return torch.cat([d for d, _, _ in lights]), torch.cat(power)


def _half_vector_rings(rings: int, around: int) -> tuple[Tensor, Tensor]:
    """Return half vectors on rings about a normal, dense towards it.

    Args:
        rings: number of rings.
        around: number of half vectors on each ring.

    Returns:
        Unit vectors [M, 3], and each one's share of d half in sr, [M].
    """
    nodes, weights = gauss_legendre(rings)
    narrowest, reach = 0.05, math.asinh(math.pi / 2 / 0.05)
    theta_h = (narrowest * (nodes * reach).sinh())[:, None]
    width = math.tau / around
    share = weights[:, None] * narrowest * reach * (nodes[:, None] * reach).cosh() * theta_h.sin() * width
    phi_h = (torch.arange(around, dtype=torch.float64) + 0.5) * width
    half = torch.stack(
        [theta_h.sin() * phi_h.cos(), theta_h.sin() * phi_h.sin(), theta_h.cos().expand(rings, around)], dim=-1
    ).reshape(-1, 3)
    return half, share.expand(rings, around).reshape(-1)


def _ring_quadrature(wo: Tensor, rings: int, around: int) -> tuple[Tensor, Tensor]:
    """Return a quadrature over light for each pixel.

    Half vectors lie on rings about each pixel's normal, dense towards it, which integrates lobes of any width to a few
    percent; fixed lights would show as dots in polished metal.

    Args:
        wo: directions to the camera, [P, 3], in the frame of each pixel's point.
        rings: number of rings.
        around: number of half vectors on each ring.

    Returns:
        wi, [P, rings * around, 3], in the same frames, and solid angles in sr, [P, rings * around].
    """
    half, share = _half_vector_rings(rings, around)
    cos_d = wo @ half.T
    wi = 2 * cos_d[..., None] * half - wo[:, None]
    return wi, 4 * cos_d.clamp_min(0) * share  # d wi = 4 cos theta_d d half


_SKY_RINGS, _SKY_COLOUR = (7, 6), (0.95, 0.97, 1.0)  # rings and half vectors on each; linear RGB


def _sky_light(wo: Tensor, up: Tensor) -> tuple[Tensor, Tensor]:
    """Return the light of a dim sky for each pixel.

    Args:
        wo: directions to the camera, [P, 3], in the frame of each pixel's point.
        up: the vertical direction, [P, 3], in the same frames.

    Returns:
        Directions [P, 42, 3] and linear RGB irradiance [P, 42, 3].
    """
    wi, solid_angle = _ring_quadrature(wo, *_SKY_RINGS)
    radiance = 0.06 + 0.05 * (wi * up[:, None]).sum(-1)  # brighter above than below
    irradiance = radiance * solid_angle
    return wi, irradiance[..., None] * irradiance.new_tensor(_SKY_COLOUR)


def environment_radiance(directions: Tensor) -> Tensor:
    """Evaluate an analytic environment map: a sky above a floor, a low sun in haze, two windows.

    Args:
        directions: unit vectors [..., 3], x right, y up, z to the camera.

    Returns:
        Linear RGB radiance [..., 3], > 0, so smooth that 320 directions a pixel resolve it.
    """
    colour = directions.new_tensor
    sky_share = torch.sigmoid(12 * directions[..., 1:2])
    sky = colour([0.25, 0.35, 0.55]) + colour([0.35, 0.25, 0.10]) * torch.exp(-6 * directions[..., 1:2].square())
    radiance = sky_share * sky + (1 - sky_share) * colour([0.16, 0.13, 0.10])
    for towards, sharpness, power in (
        ((-0.55, 0.45, 0.70), 25.0, (10.0, 8.0, 5.6)),
        ((0.80, 0.35, 0.49), 20.0, (2.0, 2.3, 2.7)),
        ((0.35, 0.60, -0.72), 15.0, (2.7, 2.4, 2.1)),
    ):
        axis = torch.nn.functional.normalize(colour(towards), dim=0)
        radiance = radiance + torch.exp(sharpness * ((directions * axis).sum(-1, keepdim=True) - 1)) * colour(power)
    return radiance


def _sphere_points(size: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return the points of a sphere that the pixels of its picture show.

    Returns:
        Mask and coverage of the picture, [size, size]; and the frame of each pixel's point, [P, 3, 3], whose rows are
        tangent, bitangent and normal.
    """
    if size < 8:
        raise ValueError(f"size of the reference sphere: {size} pixels, expected at least 8")
    centre = (torch.arange(size, dtype=torch.float64) + 0.5) * 2 / size - 1
    y, x = torch.meshgrid(-centre, centre, indexing="ij")
    radius = (x * x + y * y).sqrt() / 0.96
    coverage = (0.5 + (1 - radius) * 0.96 * size / 2).clamp(0, 1)
    mask = coverage > 0
    # A pixel on the rim may have its centre outside the disc; it takes the last point inside.
    shrink = 0.96 * (radius / 0.995).clamp_min(1)
    normal_x, normal_y = (x / shrink)[mask], (y / shrink)[mask]
    normal = torch.stack([normal_x, normal_y, (1 - normal_x**2 - normal_y**2).sqrt()], dim=-1)

    # These are never parallel to the normal, which faces the camera.
    tangent = torch.nn.functional.normalize(
        torch.stack([normal[:, 2], torch.zeros_like(normal_x), -normal_x], dim=-1), dim=-1
    )
    frame = torch.stack([tangent, torch.linalg.cross(normal, tangent), normal], dim=1)
    return mask, coverage, frame


def _exposure_factor(wi: Tensor, irradiance: Tensor) -> Tensor:
    """Return the factor of light by which a white diffuse sphere of albedo 0.8 is 0.85 where it is brightest."""
    return 0.85 * math.pi / 0.8 / (irradiance * wi[..., 2:].clamp_min(0)).sum(1).mean(-1).max()


def _studio_illumination(frame: Tensor) -> tuple[Tensor, Tensor]:
    """Return light of the reference picture at points with frames [P, 3, 3].

    Returns:
        Directions and linear RGB irradiance, both [P, 103, 3].
    """
    directions, irradiance = _studio_lights()
    sky, sky_irradiance = _sky_light(frame[:, :, 2], frame[:, :, 1])
    wi = torch.cat([torch.einsum("pij,lj->pli", frame, directions), sky], dim=1)
    return wi, torch.cat([irradiance.expand(len(wi), -1, -1), sky_irradiance], dim=1)


def _environment_illumination(frame: Tensor) -> tuple[Tensor, Tensor]:
    """Return light of :func:`environment_radiance` at points with frames [P, 3, 3].

    Returns:
        Directions and linear RGB irradiance, both [P, 320, 3].
    """
    wi, solid_angle = _ring_quadrature(frame[:, :, 2], 16, 20)
    return wi, environment_radiance(torch.einsum("pji,plj->pli", frame, wi)) * solid_angle[..., None]


@functools.cache
def studio_lights() -> Tensor:
    """Return the lights of the reference picture as numbers, float32 [2, 103, 4], at the picture's exposure.

    The first row holds directions (x right, y up, z to the camera) and 0, the second linear RGB irradiance across the
    beam and 0. Of the sky these are half vectors in the frame of each point and 0, and its colour times the share of
    d half in sr, and 1: radiance is 0.06 + 0.05 times the light's y, and d wi = 4 cos theta_d d half.
    """
    exposure = _exposure_factor(*_studio_illumination(_sphere_points(96)[2]))
    directions, irradiance = _studio_lights()
    half, half_solid_angle = _half_vector_rings(*_SKY_RINGS)
    sky = half_solid_angle[:, None] * half_solid_angle.new_tensor(_SKY_COLOUR)
    directions_or_halves, irradiance_or_colour = torch.cat([directions, half]), exposure * torch.cat([irradiance, sky])
    is_sky = torch.arange(len(directions_or_halves)) >= len(directions)
    lights = [
        torch.nn.functional.pad(directions_or_halves, (0, 1)),
        torch.cat([irradiance_or_colour, is_sky[:, None]], 1),
    ]
    return torch.stack(lights).float()


def shade_sphere(scene: SphereScene, evaluate: Callable[[Tensor], Tensor], *, chunk: int = 8192) -> Tensor:
    """Render a sphere of some BRDF.

    Args:
        scene: the geometry and lights.
        evaluate: returns the BRDF [..., 3] in 1/sr, linear RGB, at angles of the scene; called with [<= chunk, 3 or 4].
        chunk: (pixel, light) pairs a call, few enough to stay in the CPU's cache.

    Returns:
        [size, size, 4]: linear RGB radiance on black (that is, times coverage: associated alpha, as in EXR), coverage.
    """
    lit = scene.weights.amax(-1) > 0
    pixel = lit.nonzero()[:, 0]
    pairs = zip(scene.angles[lit].split(chunk), scene.weights[lit].split(chunk), strict=True)
    radiance = torch.cat([evaluate(angles) * weights for angles, weights in pairs])
    coverage = scene.coverage[scene.mask][:, None].to(radiance)
    linear_rgb = radiance.new_zeros(len(coverage), 3).index_add(0, pixel, radiance)
    image = radiance.new_zeros(*scene.mask.shape, 4)
    image[scene.mask] = torch.cat([linear_rgb * coverage, coverage], dim=-1)
    return image


@functools.cache
def reference_scene(size: int = 96, *, azimuths: bool = False) -> SphereScene:
    """Return the scene of all BRDF pictures, of fits and references alike: three softboxes, a small lamp and a dim sky.

    Args:
        size: width and height in pixels, >= 8; the sphere fills 96 % of it.
        azimuths: whether angles include phi_h, for anisotropic reflection.
    """
    return _load_scene(f"studio-{size}", size, _studio_illumination, azimuths)


@functools.cache
def environment_scene(*, azimuths: bool = False) -> SphereScene:
    """Return the scene of a sphere at 48 px under :func:`environment_radiance` alone, 320 directions a pixel.

    Args:
        azimuths: whether angles include phi_h, for anisotropic reflection.
    """
    return _load_scene("environment-48", 48, _environment_illumination, azimuths)


def _load_scene(name: str, size: int, light: Callable[[Tensor], tuple[Tensor, Tensor]], azimuths: bool) -> SphereScene:
    """Return a scene, float32, from the cache or made now.

    A white diffuse sphere of albedo 0.8 is 0.85 where it is brightest.

    Args:
        name: name of the lights and the size in the cache.
        size: width and height in pixels.
        light: returns directions and irradiance, both [P, L, 3], at points with frames [P, 3, 3].
        azimuths: whether angles include phi_h.
    """

    def make() -> dict[str, Tensor]:
        mask, coverage, frame = _sphere_points(size)
        wi, irradiance = light(frame)
        weights = irradiance * wi[..., 2:].clamp_min(0) * _exposure_factor(wi, irradiance)
        to_angles = directions_to_four_angles if azimuths else directions_to_full_rusinkiewicz
        angles = to_angles(wi, frame[:, None, :, 2].expand_as(wi))
        return {"mask": mask, "coverage": coverage.float(), "angles": angles.float(), "weights": weights.float()}

    return SphereScene(
        **load_or_compute_tensors(f"sphere-{name}{'-phi_h' * azimuths}", (__file__, geometry.__file__), make)
    )
