"""Maps of stationary svBRDFs as pictures."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear, stretched
from metapp.appearance.flash import Maps, relightings
from metapp.learning.pictures import Picture

Photograph = Callable[[Maps, Tensor, Tensor], Tensor]  # display values of maps, light and view


@torch.no_grad()
def pictures_of(maps: Maps, height: Tensor, photograph: Photograph) -> dict[str, Picture]:
    """Maps [C, H, W], specular colour as F0, height [1, H, W], and photographs of them under other lights."""
    pictures = {
        "diffuse": Picture(linear_to_srgb(maps.diffuse), "srgb"),
        "specular": Picture(linear_to_srgb(maps.specular), "srgb"),
        "roughness": Picture(maps.roughness, "data"),
        "normal": Picture(maps.normal * 0.5 + 0.5, "data"),
        "height": Picture(height, "height"),
    }
    for name, (light, view) in relightings(device=height.device).items():
        pictures[f"lit_from_{name}"] = Picture(photograph(maps, light, view), "srgb")
    return {name: Picture(each.pixels.permute(1, 2, 0), each.kind) for name, each in pictures.items()}


def preview_of(photo: Tensor, fit: Tensor, pictures: dict[str, Picture]) -> dict[str, Tensor]:
    """Photo and fit under its light [3, H, W], then what `pictures_of` makes, as linear RGB [H, W, 3]."""
    displayed = {"reference": photo.permute(1, 2, 0), "fit": fit.permute(1, 2, 0)}
    displayed |= {name: picture.pixels for name, picture in pictures.items()}
    displayed["height"] = stretched(displayed["height"])[0]
    return {name: srgb_to_linear(picture).expand(-1, -1, 3) for name, picture in displayed.items()}
