"""The maps of a fitted flat surface, and those of the metallic-roughness workflow of other programs.

In the workflow a texel is a mixture of a dielectric of specular reflectance c = 0.04 and a metal, as in glTF 2.0's core
materials:

    diffuse = base (1 - metallic)        F0 = c (1 - metallic) + base metallic
"""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from metapp.appearance.flash import Maps, height_from_normal

DIELECTRIC = 0.04  # reflectance at normal incidence of nearly all that is no metal
DESCRIPTION = "material.json"  # describes the files of an asset folder


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


def from_metallic(base: Tensor, metallic: Tensor) -> tuple[Tensor, Tensor]:
    """Diffuse and specular colour [..., 3, H, W] of the workflow's maps."""
    return base * (1 - metallic), DIELECTRIC * (1 - metallic) + base * metallic
