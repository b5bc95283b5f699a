"""Surfaces of a whole patch that varies from place to place: layers with bevelled edges, down to the maps of a task.

A patch has borders but does not repeat. Fields are float32 [S, S], rows downwards; lengths are in texels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from data_tools.random_streams import Rng
from data_tools.synthetic.patterns.fields import blur_periodic, fbm, mix, smoothstep
from data_tools.synthetic.random_values import Field
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.svbrdf_maps import Maps, pack_maps

MIN_PATCH_ROUGHNESS, MAX_PATCH_ROUGHNESS = 0.1, 0.95

_MARGIN = 32  # texels by which a patch is mirrored beyond its borders for a blur


class PatchSurface(NamedTuple):
    """A patch of material, all float32.

    Attributes:
        diffuse: linear RGB albedo [3, S, S] in [0, 1].
        specular: linear RGB reflectance at normal incidence [3, S, S] in [0, 1].
        roughness: [S, S] in [0, 1]; the alpha of GGX is its square.
        height: [S, S] in texels.
    """

    diffuse: Field
    specular: Field
    roughness: Field
    height: Field


def blend_surfaces(under: PatchSurface, over: PatchSurface, weight: Field | float) -> PatchSurface:
    """Blend a surface (weight 0) with another one (weight 1), their heights as well; the weight may be [S, S]."""
    return PatchSurface(*(mix(first, second, weight) for first, second in zip(under, over, strict=True)))


def lay_surface(
    under: PatchSurface, over: PatchSurface, inside: Field, thickness: float = 0.0, bevel: float = 1.5
) -> PatchSurface:
    """Lay a surface on another one, or let it in.

    Args:
        under: the surface around the new one.
        over: the new surface.
        inside: distance [S, S] to its rim in texels, negative outside.
        thickness: how far it stands out, in texels; negative if it is let in.
        bevel: width of the slope within its rim, in texels.
    """
    return add_relief(blend_surfaces(under, over, rim_coverage(inside)), thickness * smoothstep(inside, -0.5, bevel))


def rim_coverage(inside: Field) -> Field:
    """Return the share of a texel [S, S] that lies within a rim, from the distance to the rim in texels."""
    return smoothstep(inside, -0.8, 0.8)


def add_relief(surface: PatchSurface, relief: Field | float) -> PatchSurface:
    """Add a relief [S, S] in texels to the height of a surface."""
    return surface._replace(height=surface.height + relief)


def tint_surface(surface: PatchSurface, factor: Field | float, reflectance: Field | float = 1.0) -> PatchSurface:
    """Multiply the albedo of a surface by `factor` and its reflectance by `reflectance`, each [S, S] or [3, S, S]."""
    return surface._replace(diffuse=surface.diffuse * factor, specular=surface.specular * reflectance)


def blend_towards(field: Field, value: float, weight: Field) -> Field:
    """Blend a field (weight 0) with a value (weight 1)."""
    return field + (np.float32(value) - field) * weight


def distance_to_zero(field: Field) -> Field:
    """Return the distance [S, S] to a smooth field's zero in texels, with the field's sign; right near zero only."""
    along_y, along_x = np.gradient(field)
    result: Field = field / np.maximum(np.hypot(along_x, along_y), 1e-3)
    return result


def cloud_noise(
    rng: Rng, size: int, frequency: float, slope: float = 2.0, stretch: float = 1.0, angle_rad: float = 0.0
) -> Field:
    """Return noise of all scales, like `patterns.fields.fbm`, that does not repeat: [S, S], variance about 1.

    The frequency is in cycles per patch, about 1 or more.
    """
    padded_size = size * 3 // 2
    return fbm(rng, padded_size, frequency * 1.5, slope, stretch, angle_rad)[:size, :size]


def blur_mirrored(field: Field, sigma: float) -> Field:
    """Blur a field by a Gaussian of sigma texels, at most 12; the patch is mirrored at its borders."""
    padded = np.pad(field, _MARGIN, mode="symmetric")
    return blur_periodic(padded, sigma / padded.shape[0])[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN]


def local_relief(height: Field, sigma: float = 3.0) -> Field:
    """Return how far texels stand out of their neighbourhood of sigma texels, in texels: edges > 0, cavities < 0."""
    return height - blur_mirrored(height, sigma)


def pack_surface(surface: PatchSurface) -> Tensor:
    """Return the maps [10, S, S] of a surface within their ranges, packed by `metapp.appearance.svbrdf_maps.pack_maps`.

    The albedo of dielectrics is clamped to 0.02 .. 0.85, of metals to 0 .. 0.2; the reflectance to 0.02 .. 1 and the
    roughness to MIN_PATCH_ROUGHNESS .. MAX_PATCH_ROUGHNESS.
    """
    specular = np.clip(surface.specular, 0.02, 1)
    metallic = smoothstep(specular.mean(0), 0.15, 0.4)
    diffuse = np.clip(surface.diffuse, 0.02 * (1 - metallic), 0.85 - 0.65 * metallic)
    roughness = np.clip(surface.roughness, MIN_PATCH_ROUGHNESS, MAX_PATCH_ROUGHNESS)[None]
    fields = (diffuse, specular, roughness, surface.height[None])
    albedo, reflectance, rough, height = (torch.from_numpy(field.astype(np.float32)) for field in fields)
    return pack_maps(Maps(albedo, reflectance, rough, normal_from_height(height, periodic=False)))
