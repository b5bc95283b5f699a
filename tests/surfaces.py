"""Surfaces and height fields for tests: every map varies, colours of F0 too."""

import math
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import torch
from torch import Tensor

from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.flash import Maps, normal_from_height
from metapp.appearance.surface import Surface

PROVENANCE = {"task": "rock", "app": "svbrdf_nonstationary", "rise": math.inf, "versions": {"metapp": "0"}}


def rock(size: int = 32, *, tiles: bool = True) -> Surface:
    """Waves that tile, of a metal and of something else, in colours that have nothing to do with each other."""
    x, y = (2 * math.pi * each / size for each in torch.meshgrid(*2 * [torch.arange(float(size))], indexing="xy"))
    height = (1.5 * x.sin() + (y + 2 * x).cos())[None]
    diffuse = torch.stack([0.4 + 0.3 * x.cos(), 0.35 + 0.3 * y.sin(), 0.3 + 0.2 * (x + y).cos()])
    specular = torch.stack([0.45 + 0.44 * y.cos(), 0.3 + 0.27 * (x - y).sin(), 0.04 + 0.03 * x.sin()])
    roughness = 0.5 + 0.35 * (2 * y).sin()[None]
    normal = normal_from_height(height[None], periodic=tiles)[0]
    return Surface(diffuse, tiles, Maps(diffuse, specular, roughness, normal), height if tiles else None)


def texture(size: int = 32) -> Surface:
    return Surface(rock(size).base, True)


def stored(file: Path) -> Tensor:
    """Values [C, H, W] of an image file as they are stored, integers over their greatest."""
    pixels = np.atleast_3d(oiio.ImageBuf(str(file)).get_pixels(oiio.FLOAT))
    return torch.from_numpy(pixels).double().movedim(-1, 0)


def linear(file: Path) -> Tensor:
    """Values [C, H, W] of an image file of sRGB colours, linear."""
    return srgb_to_linear(stored(file))


def grid(size: int) -> tuple[Tensor, Tensor]:
    """x to the right and y up of texels' centres, in texels."""
    rows, columns = torch.meshgrid(*2 * [torch.arange(size, dtype=torch.float64)], indexing="ij")
    return columns + 0.5, size - 0.5 - rows


def normal_of(along_x: Tensor, along_y: Tensor) -> Tensor:
    vectors = torch.stack([-along_x, -along_y, torch.ones_like(along_x)])
    return vectors / vectors.norm(dim=0)


def waves(size: int) -> tuple[Tensor, Tensor]:
    """A field of three waves, not alike along x and y, and its exact normals."""
    x, y = (2 * math.pi * each / size for each in grid(size))
    height = 3 * (2 * x).sin() + 2 * (x + 3 * y).cos() + (y + 0.3).sin()
    scale = 2 * math.pi / size
    along_x = scale * (6 * (2 * x).cos() - 2 * (x + 3 * y).sin())
    along_y = scale * (-6 * (x + 3 * y).sin() + (y + 0.3).cos())
    return height[None], normal_of(along_x, along_y)
