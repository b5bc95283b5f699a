"""Maps of a flat material: as tasks keep them, how far two are apart, and how they are shown."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.flash import Maps, camera, expose, positions, relightings, render
from metapp.apps.svbrdf_nonstationary.views import seen
from metapp.learning.task import Params, Task
from metapp.networks.field import LocalField, field_by_rows, strips_of

RAW = (2, 3, 1, 3)  # numbers of any size in a place: slopes, diffuse colour, roughness, specular colour


def decoded(raw: Tensor) -> Maps:
    """The maps [T, C, H, W] that RAW numbers [T, 9, H, W] stand for."""
    slopes, diffuse, roughness, specular = raw.split(RAW, 1)
    return Maps(
        torch.sigmoid(diffuse) ** 2.2,  # about evenly spread for the eye
        torch.sigmoid(specular - 2) ** 2,  # about 0.02 at first, as of dielectrics
        0.05 + 0.95 * torch.sigmoid(roughness),
        of_length_1(torch.cat([slopes, torch.ones_like(roughness)], 1)),
    )


def fine_maps(field: LocalField, theta: Params, photo: Tensor) -> Maps:
    """The maps [T, C, H, W] that a field makes of linear photographs [T, 3, H, W], whose size it has.

    Made by rows: a layer of a field of 2048 x 2048 texels takes 0.5 GB.
    """
    parts = [decoded(rows) for rows in field_by_rows(field, theta, seen(photo))]
    return Maps(*(torch.cat(part, -2) for part in zip(*parts, strict=True)))


def linear(photo: Tensor) -> Tensor:
    """A photograph as tasks keep it, uint8 sRGB of any shape, in linear RGB."""
    return srgb_to_linear(photo.float() / 255)


def photo_of(task: Task, largest: int) -> Tensor:
    """The photograph, linear [1, 3, S, S], as fine as it is, but no finer than that."""
    side = min(largest, task.data["photo"].shape[-1])
    return adaptive_avg_pool2d(linear(task.data["photo"])[None], side)


def pooled(maps: Tensor, size: Any) -> Tensor:
    """Maps [..., 10, H, W] at another size, normals of unit length."""
    normal, rest = adaptive_avg_pool2d(maps, tuple(size)).split((3, 7), -3)
    return torch.cat([of_length_1(normal), rest], -3)


def of_length_1(vectors: Tensor) -> Tensor:
    """Vectors [..., 3, H, W] of length 1; many times as fast as torch's own where channels come first."""
    return vectors * vectors.square().sum(-3, keepdim=True).clamp_min(1e-24).rsqrt()


def differences(maps: Maps, target: Maps) -> list[Tensor]:
    """Of diffuse and specular colour at gamma 2.2, of roughness and of normals, [T, C, H, W] each."""
    colours = [_shades(each) - _shades(other) for each, other in zip(maps[:2], target[:2], strict=True)]
    return [*colours, maps.roughness - target.roughness, maps.normal - target.normal]


def _shades(colour: Tensor) -> Tensor:
    return (colour + 1e-3) ** (1 / 2.2)


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
