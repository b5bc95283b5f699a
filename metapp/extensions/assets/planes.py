"""The maps of a surface that other programs take: the fitted maps, the metallic-roughness workflow, occlusion.

Exports of all formats choose among these maps. Nothing here knows of files.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import torch
from torch import Tensor

from metapp.appearance.assets import Surface, Texture
from metapp.appearance.surface import DIELECTRIC_F0
from metapp.extensions.assets.occlusion import occlusion_from_height

Encoding = Literal["srgb", "linear", "stretched"]


class SurfaceMap(NamedTuple):
    """A map of a surface, with the way in which an image file holds it.

    Attributes:
        values: the texels, [1 or 3, H, W], linear; in [0, 1] except for heights.
        encoding: how a file of integers holds the values: colours as sRGB, data linearly, heights stretched to their
            range.
        meaning: what the map holds, in words, with the unit.
    """

    values: Tensor
    encoding: Encoding
    meaning: str


def fitted_surface_maps(surface: Surface | Texture) -> dict[str, SurfaceMap]:
    """Return the maps that were fitted, by name; heights are in texture widths and have a mean of 0."""
    if isinstance(surface, Texture):
        return {"basecolor": SurfaceMap(surface.colour, "srgb", "colour")}
    maps = surface.maps
    return {
        "diffuse": SurfaceMap(maps.diffuse, "srgb", "diffuse albedo"),
        "specular": SurfaceMap(maps.specular.expand(3, -1, -1), "srgb", "F0, reflectance at normal incidence"),
        "roughness": SurfaceMap(maps.roughness, "linear", "roughness; GGX alpha is its square"),
        "normal_gl": SurfaceMap(maps.normal * 0.5 + 0.5, "linear", "normal, 0..1 for -1..1; x right, y up, z out"),
        "height": SurfaceMap(surface.heights_in_widths(), "stretched", "height, up; in texture widths, mean 0"),
    }


def all_surface_maps(surface: Surface | Texture) -> dict[str, SurfaceMap]:
    """Return the fitted maps and those derived from them, by name.

    Derived are the maps of the metallic-roughness workflow, ambient occlusion, and normals as DirectX has them.
    """
    surface_maps = fitted_surface_maps(surface)
    if isinstance(surface, Texture):
        return surface_maps
    base, metallic = specular_to_metallic(surface.maps.diffuse, surface.maps.specular)
    occlusion = occlusion_from_height(surface_maps["height"].values * surface.size[1], periodic=surface.tiles)
    x, y, z = surface_maps["normal_gl"].values.unbind()
    packed = torch.cat([occlusion, surface.maps.roughness, metallic])
    return surface_maps | {
        "basecolor": SurfaceMap(base, "srgb", "base colour of the metallic-roughness workflow"),
        "metallic": SurfaceMap(metallic, "linear", "metallic of the metallic-roughness workflow"),
        "normal_dx": SurfaceMap(torch.stack([x, 1 - y, z]), "linear", "normal, 0..1 for -1..1; x right, y down, z out"),
        "ao": SurfaceMap(occlusion, "linear", "ambient occlusion, 1 is open"),
        "orm": SurfaceMap(packed, "linear", "red ambient occlusion, green roughness, blue metallic"),
    }


def specular_to_metallic(diffuse: Tensor, specular: Tensor) -> tuple[Tensor, Tensor]:
    """Return base colour and metallic, the nearest material of the metallic-roughness workflow.

    The equations are d = c_b (1 - m) for the diffuse colour and s = c (1 - m) + c_b m for the specular one, with base
    colour c_b, metallic m and the F0 of dielectrics c. Eliminating the base colour leaves c m^2 + (d + s - 2 c) m - (s
    - c) = 0, linear in d and s: it is solved for their means over the channels. The base colour is then d + s - c (1 -
    m). Both are exact if such maps exist (:func:`metapp.appearance.surface.metallic_to_specular` inverts them);
    elsewhere they are clamped to [0, 1]: a specular colour below 0.04, or of another hue than the base colour's, is
    lost, which is why formats that can hold F0 itself get it.

    Args:
        diffuse: the diffuse albedo, [..., 3, H, W], linear in [0, 1].
        specular: the reflectance at normal incidence, [..., 1 or 3, H, W] in [0, 1].

    Returns:
        The base colour, [..., 3, H, W], and metallic, [..., 1, H, W], both in [0, 1].
    """
    d, s = diffuse.mean(-3, keepdim=True), specular.mean(-3, keepdim=True)
    linear = d + s - 2 * DIELECTRIC_F0
    root = (linear * linear + 4 * DIELECTRIC_F0 * (s - DIELECTRIC_F0)).clamp_min(0).sqrt()
    metallic = ((root - linear) / (2 * DIELECTRIC_F0)).clamp(0, 1)
    metallic = metallic.where(s > DIELECTRIC_F0, metallic.new_zeros(()))
    base = (diffuse + specular - DIELECTRIC_F0 * (1 - metallic)).clamp(0, 1)
    return base, metallic
