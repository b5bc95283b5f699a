"""Non-stationary svBRDFs as tasks: maps of a flat material, texel by texel, and its photograph under a flash.

Readers of all formats of such materials make their tasks here, and render or correct their photographs.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from data_tools.readers.input_source import LAMP_COUNT_FACT, PHOTO_COUNT_FACT, REFERENCE_FACT
from data_tools.readers.named_photos import LEAST_PHOTOS
from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.flash import camera_position, render_maps, texel_positions
from metapp.appearance.svbrdf_maps import unpack_maps
from metapp.application import Facts
from metapp.learning.task import Task

UNITS = {
    "maps": "float16 [10, height, width], rows from the top: normal x, y, z (right, up, out; unit length), diffuse "
    "linear RGB albedo, roughness (GGX alpha is its square), specular linear RGB reflectance at normal incidence",
    "photo": "sRGB, uint8 0..255 [3, height, width], rows from the top; camera and flash above the centre, 45 degrees",
}

LAMP_UNITS = {
    "photo": "sRGB, uint8 0..255 [3, height, width], rows from the top; the mean of all photographs",
    "lit": "sRGB, uint8 0..255 [lamps, 3, height, width]; photographs by a camera straight above",
    "lamps": "float32 [lamps, 3], unit vectors towards the lamps: x right, y up, z towards the camera",
    "maps": UNITS["maps"] + "; colours relative to the exposure",
}

CLIPPED_RADIANCE = 0.95  # of white 1; of brighter px only a lower limit of their radiance is known
_MIN_MEAN_Z = 0.3  # of a normal map; a picture of middle brightness has 0
_MIN_NORMAL_Z = 0.02  # normals that point into the surface are raised to it, since nobody could see them


def facts_of(tensors: Mapping[str, Tensor | None]) -> Facts:
    """Return the facts that the tensors of a task state: how many photographs and lamps, and whether maps are known.

    Args:
        tensors: tensors by name; None for a tensor of which the name alone is known, as of a data set that is not read.
    """
    if "lit" in tensors:
        lit = tensors["lit"]
        # a data set that is not read tells no numbers
        count = LEAST_PHOTOS if lit is None else len(lit)
        return {PHOTO_COUNT_FACT: count, LAMP_COUNT_FACT: count, REFERENCE_FACT: "maps" in tensors}
    others = tensors.get("others")
    photo_count = 1 + len(others) if others is not None else 2 if "places" in tensors else 1
    return {PHOTO_COUNT_FACT: photo_count, REFERENCE_FACT: "maps" in tensors}


def make_svbrdf_task(name: str, maps: Tensor, *, photo: Tensor | None = None) -> Task:
    """Make the task of a material.

    Args:
        name: the name of the task.
        maps: packed maps [10, S, S]; see :func:`metapp.appearance.svbrdf_maps.pack_maps`.
        photo: its flash photograph, sRGB uint8 [3, S, S]; None to render it.

    Returns:
        A task with `maps`, float16 [10, S, S], and `photo`.
    """
    return Task(name, {"maps": maps.half(), "photo": render_flash_photo(maps) if photo is None else photo})


def render_flash_photo(
    maps: Tensor, flash: Tensor | None = None, intensity: float = 1.0, eye: Tensor | None = None
) -> Tensor:
    """Render a material under a flash, sRGB uint8 [3, H, W].

    Args:
        maps: packed maps of the material, [10, H, W].
        flash: the position [3] of the flash in half sides of the patch; None for beside the lens, straight above.
        intensity: the intensity of the flash; with 1 and beside the lens white has radiance 1 in the centre.
        eye: the position [3] of the camera in half sides of the patch; None for straight above.
    """
    above_centre = camera_position(dtype=torch.float32)
    texel_places = texel_positions(*maps.shape[-2:], dtype=torch.float32)
    light, view = (above_centre if position is None else position for position in (flash, eye))
    radiance = render_maps(unpack_maps(maps.float()), texel_places, light, view, intensity=intensity)
    return encode_srgb(radiance)


def correct_exposure(photo: Tensor, stops: float) -> Tensor:
    """Darken a photograph, sRGB uint8 [..., 3, H, W], that is `stops` stops too bright; clipped px stay white."""
    if not stops:
        return photo
    radiance = srgb_to_linear(photo.float() / 255)
    clips = (radiance > CLIPPED_RADIANCE).any(-3, keepdim=True) & (stops > 0)
    return torch.where(clips, photo, encode_srgb(radiance * 2.0**-stops))


def encode_srgb(radiance: Tensor) -> Tensor:
    """Encode linear radiance of any shape, in which 1 is white, as uint8 sRGB."""
    return (linear_to_srgb(radiance.clamp(0, 1)) * 255).round().to(torch.uint8)


def task_name(stem: str) -> str:
    """Make a plain file name of a file's stem: characters other than letters, digits, dots and hyphens become `_`.

    >>> task_name("Old brick (2)")
    'Old_brick__2_'
    """
    return re.sub(r"[^\w.-]", "_", stem).lstrip(".") or "material"


def decode_unit_normals(stored: Tensor, source: Path) -> Tensor:
    """Decode normals that an image stores.

    Args:
        stored: the image, [3, H, W] in [0, 1], 0..1 for -1..1.
        source: the file, in errors.

    Returns:
        Normals [3, H, W] of unit length, z > 0.

    Raises:
        ValueError: the normals do not point out of the surface.
    """
    vectors = stored.float() * 2 - 1
    mean_z = float(vectors[2].mean())
    if not mean_z >= _MIN_MEAN_Z:
        raise ValueError(
            f"{source}: normals with a mean z of {mean_z:.2f}, expected {_MIN_MEAN_Z} or more; export "
            "tangent-space normals, stored as 0..1 for -1..1."
        )
    return functional.normalize(torch.cat([vectors[:2], vectors[2:].clamp_min(_MIN_NORMAL_Z)]), dim=0)
