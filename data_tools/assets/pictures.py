"""Maps of surfaces as image files, and a small picture of a surface."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from torch import Tensor
from torch.nn.functional import interpolate

from metapp.appearance.colour import linear_to_srgb, stretched
from metapp.appearance.flash import Maps, expose, positions, relightings, render
from metapp.appearance.surface import Plane, Surface
from metapp.storage.images import write_png

PREVIEW = 256  # px, of the longer side


def write_planes(planes: Mapping[str, Plane], path: Path, bits: int = 16) -> dict[str, dict[str, object]]:
    """Write maps as PNG, <path>/<name>_<map>.png, `name` being the last part of `path`.

    Returns:
        What is to be known of each file, by its name: encoding, meaning; of heights how integers become widths.
    """
    files = {key: path / f"{path.name}_{key}.png" for key in planes}
    return {file.name: write_plane(planes[key], file, bits, stretch=key == "height") for key, file in files.items()}


def write_plane(plane: Plane, file: Path, bits: int, *, stretch: bool = False) -> dict[str, object]:
    """Write a map as PNG, colours as sRGB; with `stretch` so that its range becomes that of the integers.

    Returns:
        What is to be known of the file.
    """
    encoding = "sRGB" if plane.encoding == "srgb" else "linear"
    values = linear_to_srgb(plane.values.clamp(0, 1)) if plane.encoding == "srgb" else plane.values
    about = {"colour_space": encoding, "channels": len(values), "bits": bits, "meaning": plane.meaning}
    if stretch:
        values, low, high = stretched(values)
        about |= {"offset": low, "scale": high - low, "unit": "texture widths"}
    texts = {"encoding": encoding} | {key: f"{about[key]:.9g}" for key in ("offset", "scale") if key in about}
    write_png(values.movedim(0, -1), texts, file, bits)
    return about


def preview(surface: Surface) -> Tensor:
    """Display values [3, h, w] of a surface: a texture as it is, a material under a light from the left."""
    scale = min(1.0, PREVIEW / max(surface.size))
    size = [max(1, math.floor(side * scale)) for side in surface.size]
    maps = surface.maps
    if maps is None:
        return linear_to_srgb(_resized(surface.base, size).clamp(0, 1))
    light, view = relightings(dtype=surface.base.dtype)["left"]
    place = positions(*surface.size, dtype=surface.base.dtype)
    lit = render(Maps(*(part[None] for part in maps)), place, light, view)[0]
    return expose(_resized(lit, size))


def _resized(picture: Tensor, size: list[int]) -> Tensor:
    return interpolate(picture[None], size=size, mode="area")[0]
