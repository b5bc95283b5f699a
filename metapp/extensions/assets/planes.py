"""All maps of a surface that other programs take: those of the fit, of the metallic-roughness workflow, occlusion."""

from __future__ import annotations

from typing import Literal, NamedTuple

import torch
from torch import Tensor

from metapp.appearance.surface import DIELECTRIC_F0, Surface
from metapp.extensions.assets.occlusion import occlusion_from_height

Encoding = Literal["srgb", "linear", "stretched"]


class SurfaceMap(NamedTuple):
    """One map as a file holds it.

    Attributes:
        values: [1 or 3, H, W], linear; in [0, 1] but for heights.
        encoding: how a file of integers should hold it: colours as sRGB, data as they are, heights over their range.
        meaning: in words, with the unit.
    """

    values: Tensor
    encoding: Encoding
    meaning: str


def fitted_surface_maps(surface: Surface) -> dict[str, SurfaceMap]:
    """The fit's own maps, by name: heights in texture widths, about a mean of 0."""
    if surface.maps is None:
        return {"basecolor": SurfaceMap(surface.base, "srgb", "colour")}
    maps = surface.maps
    return {
        "diffuse": SurfaceMap(maps.diffuse, "srgb", "diffuse albedo"),
        "specular": SurfaceMap(maps.specular.expand(3, -1, -1), "srgb", "F0, reflectance at normal incidence"),
        "roughness": SurfaceMap(maps.roughness, "linear", "roughness; GGX alpha is its square"),
        "normal_gl": SurfaceMap(maps.normal * 0.5 + 0.5, "linear", "normal, 0..1 for -1..1; x right, y up, z out"),
        "height": SurfaceMap(surface.heights(), "stretched", "height, up; in texture widths, mean 0"),
    }


def all_surface_maps(surface: Surface) -> dict[str, SurfaceMap]:
    """The fit's own maps and derived ones: the metallic-roughness workflow, occlusion, DirectX normals."""
    planes = fitted_surface_maps(surface)
    if surface.maps is None:
        return planes
    base, metallic = specular_to_metallic(surface.maps.diffuse, surface.maps.specular)
    occlusion = occlusion_from_height(planes["height"].values * surface.size[1], periodic=surface.tiles)
    x, y, z = planes["normal_gl"].values.unbind()
    packed = torch.cat([occlusion, surface.maps.roughness, metallic])
    return planes | {
        "basecolor": SurfaceMap(base, "srgb", "base colour of the metallic-roughness workflow"),
        "metallic": SurfaceMap(metallic, "linear", "metallic of the metallic-roughness workflow"),
        "normal_dx": SurfaceMap(torch.stack([x, 1 - y, z]), "linear", "normal, 0..1 for -1..1; x right, y down, z out"),
        "ao": SurfaceMap(occlusion, "linear", "ambient occlusion, 1 is open"),
        "orm": SurfaceMap(packed, "linear", "red ambient occlusion, green roughness, blue metallic"),
    }


def specular_to_metallic(diffuse: Tensor, specular: Tensor) -> tuple[Tensor, Tensor]:
    """Base colour [..., 3, H, W] and metallic [..., 1, H, W] of diffuse and specular colour, all in [0, 1].

    Eliminating the base colour leaves c m^2 + (d + s - 2 c) m - (s - c) = 0, linear in d and s: it is solved for their
    means over the channels. The base colour is then d + s - c (1 - m). Both are exact if such maps exist
    (`from_metallic` inverts them); elsewhere they are clamped to [0, 1]: a specular colour below 0.04 or of another hue
    than the body's is lost, which is why formats that can hold F0 itself get that.

    Args:
        diffuse: [..., 3, H, W] linear in [0, 1].
        specular: [..., 1 or 3, H, W], reflectance at normal incidence in [0, 1].
    """
    d, s = diffuse.mean(-3, keepdim=True), specular.mean(-3, keepdim=True)
    linear = d + s - 2 * DIELECTRIC_F0
    root = (linear * linear + 4 * DIELECTRIC_F0 * (s - DIELECTRIC_F0)).clamp_min(0).sqrt()
    metallic = ((root - linear) / (2 * DIELECTRIC_F0)).clamp(0, 1)
    metallic = metallic.where(s > DIELECTRIC_F0, metallic.new_zeros(()))
    base = (diffuse + specular - DIELECTRIC_F0 * (1 - metallic)).clamp(0, 1)
    return base, metallic
