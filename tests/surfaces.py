"""Surfaces and height fields for tests: every map varies over the surface, the colour of the specular map too."""

import math
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import torch
from torch import Tensor

from metapp.appearance.assets import Surface, Texture
from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.svbrdf_maps import Maps

PROVENANCE = {"task": "rock", "app": "svbrdf_nonstationary", "rise": math.inf, "versions": {"metapp": "0"}}


def rock_surface(size: int = 32, *, tiles: bool = True) -> Surface:
    """Return a surface of waves that tile, partly metal, whose diffuse and specular colours are independent."""
    x, y = (2 * math.pi * places / size for places in torch.meshgrid(*2 * [torch.arange(float(size))], indexing="xy"))
    height = (1.5 * x.sin() + (y + 2 * x).cos())[None]
    diffuse = torch.stack([0.4 + 0.3 * x.cos(), 0.35 + 0.3 * y.sin(), 0.3 + 0.2 * (x + y).cos()])
    specular = torch.stack([0.45 + 0.44 * y.cos(), 0.3 + 0.27 * (x - y).sin(), 0.04 + 0.03 * x.sin()])
    roughness = 0.5 + 0.35 * (2 * y).sin()[None]
    normal = normal_from_height(height[None], periodic=tiles)[0]
    return Surface(Maps(diffuse, specular, roughness, normal), tiles, height if tiles else None)


def flat_maps(
    diffuse: float = 0.0,
    specular: float = 0.0,
    roughness: float = 0.5,
    *,
    size: tuple[int, int] = (1, 1),
    normal: tuple[float, ...] = (0.0, 0.0, 1.0),
) -> Maps:
    """Return maps that are alike everywhere, float64, [.., H, W] without a batch."""
    values = ([diffuse] * 3, [specular], [roughness], normal)
    return Maps(*(torch.tensor(v, dtype=torch.float64)[:, None, None].expand(-1, *size) for v in values))


def rock_texture(size: int = 32) -> Texture:
    """Return a texture that tiles."""
    return Texture(linear_to_srgb(rock_surface(size).maps.diffuse))


def read_stored_values(file: Path) -> Tensor:
    """Read the values [C, H, W] of an image file as they are stored; integers are divided by their maximum."""
    pixels = np.atleast_3d(oiio.ImageBuf(str(file)).get_pixels(oiio.FLOAT))
    return torch.from_numpy(pixels).double().movedim(-1, 0)


def read_linear_colours(file: Path) -> Tensor:
    """Read an image file of sRGB colours as linear values [C, H, W]."""
    return srgb_to_linear(read_stored_values(file))


def texel_centres(size: int) -> tuple[Tensor, Tensor]:
    """Return the positions of texels' centres in texels: x to the right and y up, [size, size] each."""
    rows, columns = torch.meshgrid(*2 * [torch.arange(size, dtype=torch.float64)], indexing="ij")
    return columns + 0.5, size - 0.5 - rows


def normal_from_slopes(along_x: Tensor, along_y: Tensor) -> Tensor:
    """Return the unit normals [3, H, W] of a surface whose height has these slopes."""
    vectors = torch.stack([-along_x, -along_y, torch.ones_like(along_x)])
    return vectors / vectors.norm(dim=0)


def wave_heights_and_normals(size: int) -> tuple[Tensor, Tensor]:
    """Return a height field [1, H, W] of three waves, which differ along x and y, and its exact normals [3, H, W]."""
    x, y = (2 * math.pi * places / size for places in texel_centres(size))
    height = 3 * (2 * x).sin() + 2 * (x + 3 * y).cos() + (y + 0.3).sin()
    scale = 2 * math.pi / size
    along_x = scale * (6 * (2 * x).cos() - 2 * (x + 3 * y).sin())
    along_y = scale * (-6 * (x + 3 * y).sin() + (y + 0.3).cos())
    return height[None], normal_from_slopes(along_x, along_y)
