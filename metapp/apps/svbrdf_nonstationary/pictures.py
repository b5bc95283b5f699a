"""Maps of non-stationary svBRDFs as pictures, and what they look like under other lights."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.flash import Maps, camera, expose, positions, relightings, render
from metapp.apps.svbrdf_nonstationary.maps import linear
from metapp.learning.pictures import Kind, Picture
from metapp.learning.task import Task
from metapp.networks.field import strips_of

KIND_OF: dict[str, Kind] = {"normal": "data", "roughness": "data"}  # all others are colours


def photo_of(task: Task, largest: int) -> Tensor:
    """The photograph, linear [1, 3, S, S], as fine as it is, but no finer than that."""
    side = min(largest, task.data["photo"].shape[-1])
    return adaptive_avg_pool2d(linear(task.data["photo"])[None], side)


@torch.no_grad()
def pictures_of(maps: Maps) -> dict[str, Picture]:
    """Maps [1, C, H, W] and pictures under three other lights, of their size."""
    pictures = displayed(maps) | {f"lit_from_{name}": picture for name, picture in relit(maps).items()}
    return {name: Picture(picture.permute(1, 2, 0), KIND_OF.get(name, "srgb")) for name, picture in pictures.items()}


def displayed(maps: Maps) -> dict[str, Tensor]:
    """Maps [1, ...] as images [1 or 3, H, W] in [0, 1]: colours as sRGB, the others as they are."""
    parts = Maps(*(part[0] for part in maps))
    return {
        "normal": parts.normal * 0.5 + 0.5,
        "diffuse": linear_to_srgb(parts.diffuse),
        "roughness": parts.roughness,
        "specular": linear_to_srgb(parts.specular),
    }


def relit(maps: Maps) -> dict[str, Tensor]:
    """Display values [3, H, W] of maps [1, ...] under three other lights, by name."""
    place = positions(*maps.diffuse.shape[-2:], dtype=maps.diffuse.dtype, device=maps.diffuse.device)
    pairs = relightings(device=place.device)
    return {name: _lit(maps, place, light, view) for name, (light, view) in pairs.items()}


def _lit(maps: Maps, place: Tensor, light: Tensor, view: Tensor) -> Tensor:
    """Display values [3, H, W] of maps [1, ...], by rows."""
    rows = [
        expose(render(Maps(*(part[..., first:end, :] for part in maps)), place[:, first:end], light, view))[0]
        for first, end in strips_of(*place.shape[-2:])
    ]
    return torch.cat(rows, 1)


def sheet(maps: Maps, photo: Tensor) -> Tensor:
    """One linear picture [H, W, 3]: four maps; below, the photograph's light and three others."""
    eye = camera(dtype=photo.dtype, device=photo.device)
    place = positions(*photo.shape[-2:], dtype=photo.dtype, device=photo.device)
    flash = expose(render(maps, place, eye, eye))[0]
    above = [part.expand(3, -1, -1) for part in displayed(maps).values()]
    rows = [torch.cat(row, 2) for row in (above, [flash, *relit(maps).values()])]
    return srgb_to_linear(torch.cat(rows, 1)).permute(1, 2, 0)
