"""Pictures of flat materials: maps as files show them, and renders under other lights."""

from __future__ import annotations

import torch
from torch import Tensor

from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.flash import Maps, expose, positions, relightings, render
from metapp.learning.pictures import Picture
from metapp.networks.field import strips_of


@torch.no_grad()
def map_pictures(maps: Maps, height: Tensor | None = None, *, falloff: float = 0.0) -> dict[str, Picture]:
    """Maps, specular colour as F0, and three photographs of the material under other lights, by the name of a file.

    Args:
        maps: [C, H, W] each.
        height: [1, H, W] in texels, if a fit has it.
        falloff: of the flash, as of `metapp.appearance.flash.render`.
    """
    pictures = {
        "diffuse": Picture(linear_to_srgb(maps.diffuse), "srgb"),
        "specular": Picture(linear_to_srgb(maps.specular), "srgb"),
        "roughness": Picture(maps.roughness, "data"),
        "normal": Picture(maps.normal * 0.5 + 0.5, "data"),
    }
    if height is not None:
        pictures["height"] = Picture(height, "height")
    for name, (light, view) in relightings(device=maps.diffuse.device).items():
        pictures[f"lit_from_{name}"] = Picture(photograph(maps, light, view, falloff=falloff), "srgb")
    return {name: Picture(each.pixels.permute(1, 2, 0), each.kind) for name, each in pictures.items()}


def photograph(maps: Maps, light: Tensor, view: Tensor, *, falloff: float = 0.0) -> Tensor:
    """Display values [3, H, W] of maps [C, H, W] under a flash; light and view [3]. Made by rows, for large maps."""
    place = positions(*maps.diffuse.shape[-2:], dtype=maps.diffuse.dtype, device=maps.diffuse.device)
    rows = [
        expose(render(Maps(*(p[:, top:end] for p in maps)), place[:, top:end], light, view, falloff=falloff))
        for top, end in strips_of(*place.shape[-2:])
    ]
    return torch.cat(rows, 1)
