"""The maps of a fitted flat surface, their pictures, and the metallic-roughness workflow of other programs.

In the workflow a texel is a mixture of a dielectric of specular reflectance c = 0.04 and a metal, as in glTF 2.0's core
materials:

    diffuse = base (1 - metallic)        F0 = c (1 - metallic) + base metallic
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import normalize

from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.flash import (
    Maps,
    height_from_normal,
    radiance_to_display,
    relighting_positions,
    render_maps,
    texel_positions,
)
from metapp.appearance.pictures import Picture

DIELECTRIC_F0 = 0.04  # reflectance at normal incidence of nearly all that is no metal
PHOTOGRAPH_STRIP_TEXELS = 2**17  # rendered at a time
DESCRIPTION_FILE = "material.json"  # describes the files of an asset folder


class Surface(NamedTuple):
    """A flat surface, texel by texel; row 0 is the upper edge. A texture is a base colour alone.

    Attributes:
        base: [3, H, W] linear RGB in [0, 1]: diffuse albedo, or the texture.
        tiles: whether its opposite edges match.
        maps: all maps, without leading axes; None of a texture.
        height: [1, H, W] in texels, if the fit has one.
    """

    base: Tensor
    tiles: bool
    maps: Maps | None = None
    height: Tensor | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in texels."""
        return self.base.shape[-2], self.base.shape[-1]

    def heights(self) -> Tensor:
        """Heights [1, H, W] in texture widths, about a mean of 0; those of normals if the fit has none."""
        height = self.height
        if height is None:
            assert self.maps is not None
            height = height_from_normal(self.maps.normal, periodic=self.tiles)
        return (height - height.mean()) / self.size[1]

    def linear_maps(self) -> dict[str, Tensor]:
        """The fit's own maps by name, linear: [H, W, 3], or [H, W] of roughness and of heights in texels.

        Normals are unit vectors. There are heights if the fit has them.
        """
        if self.maps is None:
            return {"basecolor": self.base.movedim(0, -1)}
        diffuse, specular, roughness, normal = self.maps
        maps = {"diffuse": diffuse, "specular": specular.expand(3, -1, -1), "normal": normal}
        maps = {name: part.movedim(0, -1) for name, part in maps.items()} | {"roughness": roughness[0]}
        return maps if self.height is None else maps | {"height": self.height[0]}


def scale_relief(maps: Maps, factor: float) -> Maps:
    """Maps [..., C, H, W] with the slopes of normals times a factor; 0: flat."""
    if factor == 1:
        return maps
    across, up = maps.normal.split((2, 1), -3)
    return maps._replace(normal=normalize(torch.cat([factor * across, up], -3), dim=-3))


def metallic_to_specular(base: Tensor, metallic: Tensor) -> tuple[Tensor, Tensor]:
    """Diffuse and specular colour [..., 3, H, W] of the workflow's maps."""
    return base * (1 - metallic), DIELECTRIC_F0 * (1 - metallic) + base * metallic


@torch.no_grad()
def map_pictures(maps: Maps, height: Tensor | None = None, *, falloff: float = 0.0) -> dict[str, Picture]:
    """Maps, specular colour as F0, and three photographs of the material under other lights, by the name of a file.

    Args:
        maps: [C, H, W] each.
        height: [1, H, W] in texels, if a fit has it.
        falloff: of the flash, as of `metapp.appearance.flash.render_maps`.
    """
    pictures = {
        "diffuse": Picture(linear_to_srgb(maps.diffuse), "srgb"),
        "specular": Picture(linear_to_srgb(maps.specular), "srgb"),
        "roughness": Picture(maps.roughness, "data"),
        "normal": Picture(maps.normal * 0.5 + 0.5, "data"),
    }
    if height is not None:
        pictures["height"] = Picture(height, "height")
    for name, (light, view) in relighting_positions(device=maps.diffuse.device).items():
        pictures[f"lit_from_{name}"] = Picture(photograph_maps(maps, light, view, falloff=falloff), "srgb")
    return {name: Picture(each.pixels.permute(1, 2, 0), each.kind) for name, each in pictures.items()}


def photograph_maps(maps: Maps, light: Tensor, view: Tensor, *, falloff: float = 0.0) -> Tensor:
    """Display values [3, H, W] of maps [C, H, W] under a flash; light and view [3]. Made by rows, for large maps."""
    place = texel_positions(*maps.diffuse.shape[-2:], dtype=maps.diffuse.dtype, device=maps.diffuse.device)
    rows = max(1, PHOTOGRAPH_STRIP_TEXELS // place.shape[-1])
    strips = zip(*(part.split(rows, -2) for part in (*maps, place)), strict=True)
    return torch.cat(
        [
            radiance_to_display(render_maps(Maps(*strip[:4]), strip[4], light, view, falloff=falloff))
            for strip in strips
        ],
        1,
    )
