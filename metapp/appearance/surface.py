"""The maps of a fitted flat surface, and those that other programs derive from them."""

from __future__ import annotations

from typing import Literal, NamedTuple

import torch
from torch import Tensor

from metapp.appearance.flash import Maps
from metapp.appearance.relief import height_from_normal, occlusion_from_height
from metapp.appearance.workflow import to_metallic

DESCRIPTION = "material.json"  # describes the files of an asset folder
Encoding = Literal["srgb", "linear"]


class Surface(NamedTuple):
    """A flat surface, texel by texel; row 0 is the upper edge. A texture is a base colour alone.

    Attributes:
        base: [3, H, W] linear RGB in [0, 1]: diffuse albedo, or the texture.
        tiles: whether its opposite edges match.
        maps: all maps, without leading axes; None of a texture.
        height: [1, H, W] in texels, where the fit has one.
    """

    base: Tensor
    tiles: bool
    maps: Maps | None = None
    height: Tensor | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in texels."""
        return self.base.shape[-2], self.base.shape[-1]


class Plane(NamedTuple):
    """One map as a file holds it.

    Attributes:
        values: [1 or 3, H, W], linear; in [0, 1] but for heights.
        encoding: how a file of integers should hold it: colours as sRGB, data as they are.
        meaning: in words, with the unit.
    """

    values: Tensor
    encoding: Encoding
    meaning: str


def fitted_planes(surface: Surface) -> dict[str, Plane]:
    """The fit's own maps, by name: heights in texture widths, about a mean of 0."""
    if surface.maps is None:
        return {"basecolor": Plane(surface.base, "srgb", "colour")}
    maps, height = surface.maps, surface.height
    if height is None:
        height = height_from_normal(maps.normal, periodic=surface.tiles)
    height = (height - height.mean()) / surface.size[1]
    return {
        "diffuse": Plane(maps.diffuse, "srgb", "diffuse albedo"),
        "specular": Plane(maps.specular.expand(3, -1, -1), "srgb", "F0, reflectance at normal incidence"),
        "roughness": Plane(maps.roughness, "linear", "roughness; GGX alpha is its square"),
        "normal_gl": Plane(maps.normal * 0.5 + 0.5, "linear", "normal, 0..1 for -1..1; x right, y up, z out"),
        "height": Plane(height, "linear", "height, up; in texture widths, mean 0"),
    }


def all_planes(surface: Surface) -> dict[str, Plane]:
    """The fit's own maps and derived ones: the metallic-roughness workflow, occlusion, DirectX normals."""
    planes = fitted_planes(surface)
    if surface.maps is None:
        return planes
    base, metallic = to_metallic(surface.maps.diffuse, surface.maps.specular)
    occlusion = occlusion_from_height(planes["height"].values * surface.size[1], periodic=surface.tiles)
    x, y, z = planes["normal_gl"].values.unbind()
    packed = torch.cat([occlusion, surface.maps.roughness, metallic])
    return planes | {
        "basecolor": Plane(base, "srgb", "base colour of the metallic-roughness workflow"),
        "metallic": Plane(metallic, "linear", "metallic of the metallic-roughness workflow"),
        "normal_dx": Plane(torch.stack([x, 1 - y, z]), "linear", "normal, 0..1 for -1..1; x right, y down, z out"),
        "ao": Plane(occlusion, "linear", "ambient occlusion, 1 is open"),
        "orm": Plane(packed, "linear", "red ambient occlusion, green roughness, blue metallic"),
    }
