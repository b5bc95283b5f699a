"""Non-stationary svBRDFs as tasks: maps of a flat material, texel by texel, and its photograph under a flash."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from data_tools.readers.input_source import PHOTO_COUNT_FACT, Facts
from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.flash import camera_position, render_maps, texel_positions, unpack_maps
from metapp.learning.task import Task

UNITS = {
    "maps": "float16 [10, height, width], rows from the top: normal x, y, z (right, up, out; unit length), diffuse "
    "linear RGB albedo, roughness (GGX alpha is its square), specular linear RGB reflectance at normal incidence",
    "photo": "sRGB, uint8 0..255 [3, height, width], rows from the top; camera and flash above the centre, 45 degrees",
}

CLIPPED_RADIANCE = 0.95  # of white: brighter px say no more than "at least so bright"
_MIN_HEIGHT = 0.3  # mean z of normals; a picture of middle brightness has 0
_LOWEST = 0.02  # z of a normal: what points into the surface cannot be seen


def facts_of(tensors: Mapping[str, Tensor | None]) -> Facts:
    """Return what tensors of a task tell; values are None where names alone are known, as of data sets."""
    others = tensors.get("others")
    return {PHOTO_COUNT_FACT: 1 + len(others) if others is not None else 2 if "places" in tensors else 1}


def make_svbrdf_task(name: str, maps: Tensor, *, photo: Tensor | None = None) -> Task:
    """A material of maps [10, S, S], as of `pack`: `maps` float16 and `photo` uint8 [3, S, S], rendered if None."""
    return Task(name, {"maps": maps.half(), "photo": render_flash_photo(maps) if photo is None else photo})


def render_flash_photo(
    maps: Tensor, flash: Tensor | None = None, intensity: float = 1.0, eye: Tensor | None = None
) -> Tensor:
    """A material [10, H, W] under a flash, uint8 sRGB [3, H, W].

    Args:
        maps: the material.
        flash: its place [3] as of `render_maps`; None for beside the lens, straight above.
        intensity: of the flash; with 1 and beside the lens white has radiance 1 in the centre.
        eye: the camera's place [3]; None for straight above.
    """
    above = camera_position(dtype=torch.float32)
    place = texel_positions(*maps.shape[-2:], dtype=torch.float32)
    light, view = (above if each is None else each for each in (flash, eye))
    radiance = render_maps(unpack_maps(maps.float()), place, light, view, intensity=intensity)
    return encode_srgb(radiance)


def correct_exposure(photo: Tensor, stops: float) -> Tensor:
    """A photograph, uint8 sRGB [..., 3, H, W], that is too bright by so many stops; clipped px stay white."""
    if not stops:
        return photo
    radiance = srgb_to_linear(photo.float() / 255)
    clips = (radiance > CLIPPED_RADIANCE).any(-3, keepdim=True) & (stops > 0)
    return torch.where(clips, photo, encode_srgb(radiance * 2.0**-stops))


def encode_srgb(radiance: Tensor) -> Tensor:
    """Linear radiance of any shape, 1 is white, as uint8 sRGB."""
    return (linear_to_srgb(radiance.clamp(0, 1)) * 255).round().to(torch.uint8)


def task_name(stem: str) -> str:
    """A file's stem as a plain file name: other characters than letters, digits, dots and hyphens become `_`.

    >>> task_name("Old brick (2)")
    'Old_brick__2_'
    """
    return re.sub(r"[^\w.-]", "_", stem).lstrip(".") or "material"


def decode_unit_normals(stored: Tensor, source: Path) -> Tensor:
    """Normals [3, H, W] of unit length, z > 0, of an image in [0, 1], whose 0.5 is 0.

    Raises:
        ValueError: they do not point out of the surface.
    """
    vectors = stored.float() * 2 - 1
    height = float(vectors[2].mean())
    if not height >= _MIN_HEIGHT:
        raise ValueError(
            f"{source}: normals with a mean z of {height:.2f}, expected {_MIN_HEIGHT} or more; it holds something "
            "else, or not as tangent-space normals (0..1 for -1..1)."
        )
    return functional.normalize(torch.cat([vectors[:2], vectors[2:].clamp_min(_LOWEST)]), dim=0)
