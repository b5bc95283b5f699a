"""Assets: what fits and baselines answer with, as people use it.

An asset is complete without the fit that made it. Its pictures, maps and exports are made of it alone, so that they
are written once for each type of asset, whatever application, paradigm or baseline made it. The types that several
applications share are here; an application defines its own where it is defined itself.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor
from typing_extensions import override

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.distant_lamps import render_lit
from metapp.appearance.flash import camera_position, render_maps, texel_positions
from metapp.appearance.height_fields import height_from_normal
from metapp.appearance.pictures import Picture
from metapp.appearance.surface import map_pictures, photograph_maps, scale_relief
from metapp.appearance.svbrdf_maps import Maps


class Asset(ABC):
    """A reproduced appearance: a texture, a flat surface, light, reflectance.

    Attributes:
        kind: the name of the type of asset, for which exports are registered.
    """

    kind: ClassVar[str]

    @abstractmethod
    def pictures(self) -> dict[str, Picture]:
        """Return the picture files of the asset for its user, by the file's name without its ending."""

    @abstractmethod
    def preview(self) -> Tensor:
        """Return one linear RGB picture of the asset, [H, W, 3], or [H, W, 4] with coverage."""

    def linear_maps(self) -> dict[str, Tensor]:
        """Return the maps of the asset, linear, [H, W] or [H, W, 3], by name; {} if it has none."""
        return {}


@dataclass(frozen=True, eq=False)
class Texture(Asset):
    """A texture.

    Attributes:
        pixels: display values (sRGB) in [0, 1], [3, H, W].
        tiles: whether its opposite edges match.
    """

    kind = "texture"
    pixels: Tensor
    tiles: bool = True

    @property
    def size(self) -> tuple[int, int]:
        """The height and width in px."""
        return self.pixels.shape[-2], self.pixels.shape[-1]

    @property
    def colour(self) -> Tensor:
        """The linear RGB colour in [0, 1], [3, H, W]."""
        return srgb_to_linear(self.pixels)

    @override
    def pictures(self) -> dict[str, Picture]:
        return {"texture": Picture(self.pixels.permute(1, 2, 0), "srgb")}

    @override
    def preview(self) -> Tensor:
        return self.colour.permute(1, 2, 0)

    @override
    def linear_maps(self) -> dict[str, Tensor]:
        return {"basecolor": self.colour.movedim(0, -1)}


class Photograph(NamedTuple):
    """A photograph of a flat surface under a flash.

    Attributes:
        light_position: the position of the flash in half sides of the surface, [3].
        camera_position: the position of the camera in half sides of the surface, [3].
        gain: the intensity of the flash, see :func:`metapp.appearance.flash.render_maps`.
        falloff: the fall-off of the flash, of which `axis` is the axis.
        axis: the direction in which the flash points, [3]; None for straight down.
        pixels: the photograph, linear RGB [3, H, W] in [0, 1], or sRGB uint8; None if it is not at hand.
        shown_share: the share of the surface's side that the photograph shows, from the upper left corner; 1 is all.
    """

    light_position: Tensor
    camera_position: Tensor
    gain: Tensor | float = 1.0
    falloff: Tensor | float = 0.0
    axis: Tensor | None = None
    pixels: Tensor | None = None
    shown_share: float = 1.0

    def linear_pixels(self) -> Tensor | None:
        """Return the photograph, linear RGB [3, H, W] in [0, 1]; None if it is not at hand."""
        if self.pixels is None or self.pixels.is_floating_point():
            return self.pixels
        return srgb_to_linear(self.pixels / 255)


@dataclass(frozen=True, eq=False)
class Surface(Asset):
    """A flat surface of a material, texel by texel; row 0 is the upper edge.

    Attributes:
        maps: the maps, [C, H, W] each.
        tiles: whether its opposite edges match.
        height: the heights in texels, [1, H, W], if the fit has them.
        falloff: the fall-off of the flash in pictures under other lights.
        photos: the photographs that the fit saw, by name, each with the flash where the fit places it.
        lit_photos: the photographs under many lamps that the fit saw, if it saw such.
    """

    kind = "surface"
    maps: Maps
    tiles: bool
    height: Tensor | None = None
    falloff: float = 0.0
    photos: Mapping[str, Photograph] = field(default_factory=dict)
    lit_photos: Any = None

    @property
    def size(self) -> tuple[int, int]:
        """The height and width in texels."""
        return self.maps.diffuse.shape[-2], self.maps.diffuse.shape[-1]

    def heights_in_widths(self) -> Tensor:
        """Return heights [1, H, W] in texture widths, about a mean of 0; if the fit has none, its normals' integral."""
        height = self.height
        if height is None:
            height = height_from_normal(self.maps.normal, periodic=self.tiles)
        return (height - height.mean()) / self.size[1]

    def scale_relief(self, factor: float) -> Surface:
        """Return the surface with slopes and heights scaled by a factor; 0 makes it flat."""
        height = None if self.height is None else factor * self.height
        return replace(self, maps=scale_relief(self.maps, factor), height=height)

    def photograph(self, photo: Photograph) -> Tensor:
        """Return what a photograph shows of the surface, display values [3, H, W] in [0, 1].

        Args:
            photo: where its flash and its camera are; `pixels` and `shown_share` are not read.
        """
        maps = Maps(*(part[None] for part in self.maps))
        positions = texel_positions(*self.size, dtype=maps.diffuse.dtype, device=maps.diffuse.device)
        lamp, camera = photo.light_position[None], photo.camera_position[None]
        axis = None if photo.axis is None else photo.axis[None]
        radiance = render_maps(maps, positions, lamp, camera, intensity=photo.gain, falloff=photo.falloff, axis=axis)
        return linear_to_srgb(radiance[0].clamp(0, 1))

    def relight(self, directions: Tensor) -> Tensor:
        """Return the surface under distant lamps, one at a time, from straight above.

        Args:
            directions: unit vectors towards K lamps, [K, 3]: x right, y up, z towards the camera.

        Returns:
            Linear RGB pictures [K, 3, H, W] in [0, 1].
        """
        texels = Maps(*(part.flatten(1)[None, ..., None] for part in self.maps))
        pictures = torch.stack([render_lit(texels, lamp[None, None])[0, 0] for lamp in directions])
        return pictures.clamp(0, 1).reshape(-1, 3, *self.size)

    @override
    def pictures(self) -> dict[str, Picture]:
        """Return the maps, pictures under other lights, and several photographs as the maps show them, if there are."""
        pictures = map_pictures(self.maps, self.height, falloff=self.falloff)
        for name, photo in self.photos.items() if len(self.photos) > 1 else ():
            pictures[name] = Picture(self.photograph(photo).permute(1, 2, 0), "srgb")
        return pictures

    @override
    def preview(self) -> Tensor:
        """Return the surface under a flash beside the lens, linear [H, W, 3]."""
        eye = camera_position(device=self.maps.diffuse.device)
        return srgb_to_linear(photograph_maps(self.maps, eye, eye, falloff=self.falloff)).permute(1, 2, 0)

    @override
    def linear_maps(self) -> dict[str, Tensor]:
        """Return the maps: [H, W, 3], or [H, W] for roughness and heights in texels. Normals have unit length."""
        diffuse, specular, roughness, normal = self.maps
        maps = {"diffuse": diffuse, "specular": specular.expand(3, -1, -1), "normal": normal}
        maps = {name: tensor.movedim(0, -1) for name, tensor in maps.items()} | {"roughness": roughness[0]}
        return maps if self.height is None else maps | {"height": self.height[0]}
