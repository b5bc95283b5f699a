"""Pictures of the maps of a flat surface, and the metallic-roughness workflow of other programs.

In the workflow a texel is a mixture of a dielectric of specular reflectance c = 0.04 and a metal, as in glTF 2.0's core
materials:

    diffuse = base (1 - metallic)        F0 = c (1 - metallic) + base metallic
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import normalize

from metapp.appearance.colour import linear_to_srgb, radiance_to_display
from metapp.appearance.flash import relighting_positions, render_maps, texel_positions
from metapp.appearance.pictures import Picture
from metapp.appearance.svbrdf_maps import Maps

DIELECTRIC_F0 = 0.04  # reflectance at normal incidence of nearly all materials but metals
PHOTOGRAPH_STRIP_TEXELS = 2**17  # texels rendered at a time
DESCRIPTION_FILE = "material.json"  # name of the file that describes the files of an asset folder


def scale_relief(maps: Maps, factor: float) -> Maps:
    """Scale the slopes of normals in maps [..., C, H, W] by a factor; 0 makes them flat."""
    if factor == 1:
        return maps
    across, up = maps.normal.split((2, 1), -3)
    return maps._replace(normal=normalize(torch.cat([factor * across, up], -3), dim=-3))


def metallic_to_specular(base: Tensor, metallic: Tensor) -> tuple[Tensor, Tensor]:
    """Convert maps of the workflow to diffuse and specular colour, linear RGB [..., 3, H, W] both.

    Args:
        base: base colour, linear RGB [..., 3, H, W].
        metallic: share of the metal in [0, 1], [..., 1, H, W].
    """
    return base * (1 - metallic), DIELECTRIC_F0 * (1 - metallic) + base * metallic


@torch.no_grad()
def map_pictures(maps: Maps, height: Tensor | None = None, *, falloff: float = 0.0) -> dict[str, Picture]:
    """Return pictures of maps, specular colour as F0, and three photographs under other lights, by the name of a file.

    Args:
        maps: [C, H, W] each.
        height: [1, H, W] in texels, if a fit has it.
        falloff: fall-off of the flash, see :func:`metapp.appearance.flash.render_maps`.
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
    return {name: Picture(picture.pixels.permute(1, 2, 0), picture.kind) for name, picture in pictures.items()}


def photograph_maps(maps: Maps, light: Tensor, view: Tensor, *, falloff: float = 0.0) -> Tensor:
    """Photograph maps under a flash, by strips of rows, since maps may be large.

    Args:
        maps: [C, H, W] each.
        light: position of the flash in half sides of the patch, [3].
        view: position of the camera in half sides of the patch, [3].
        falloff: fall-off of the flash, see :func:`metapp.appearance.flash.render_maps`.

    Returns:
        Display values [3, H, W] in [0.002, 1].
    """
    positions = texel_positions(*maps.diffuse.shape[-2:], dtype=maps.diffuse.dtype, device=maps.diffuse.device)
    rows = max(1, PHOTOGRAPH_STRIP_TEXELS // positions.shape[-1])
    strips = zip(*(tensor.split(rows, -2) for tensor in (*maps, positions)), strict=True)
    return torch.cat(
        [
            radiance_to_display(render_maps(Maps(*strip[:4]), strip[4], light, view, falloff=falloff))
            for strip in strips
        ],
        1,
    )
