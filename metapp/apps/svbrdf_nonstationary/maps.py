"""Maps of a flat material, the distance of two, and their radiance by eye, light and flash."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, pad

from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.flash import (
    Maps,
    camera,
    camera_distance,
    positions,
    render,
)
from metapp.learning.draws import uniform

RAW = (2, 3, 1, 3)  # numbers of any size in a place: slopes, diffuse colour, roughness, specular colour
ROUGHNESS = RAW[0] + RAW[1]  # the place of roughness among these numbers
INPUTS = 8  # numbers of a pixel of a photograph that fields and encoders read
FLASH = 4  # numbers that describe a flash
ACROSS, UP, BRIGHT = 0.3, 0.2, 0.3  # and how much one of each is: half sides aside, the log of the height, of the gain
LEAST_ROUGHNESS = 0.05
CLIPPED_VALUE = 0.95  # of white: what a photograph shows no more
LEAST_COSINE = 0.4  # cosine with the patch's normal of the most oblique light or view
STRIDE = 64  # a picture's side over how far apart neighbours are that contrasts are taken of


def decoded(raw: Tensor) -> Maps:
    """The maps [T, C, H, W] that RAW numbers [T, 9, H, W] stand for."""
    slopes, diffuse, roughness, specular = raw.split(RAW, 1)
    return Maps(
        torch.sigmoid(diffuse) ** 2.2,  # about evenly spread for the eye
        torch.sigmoid(specular - 2) ** 2,  # about 0.02 at first, as of dielectrics
        LEAST_ROUGHNESS + (1 - LEAST_ROUGHNESS) * torch.sigmoid(roughness),
        of_length_1(torch.cat([slopes, torch.ones_like(roughness)], 1)),
    )


def raw_roughness(roughness: Tensor) -> Tensor:
    """The numbers that `decoded` makes this roughness of, clear of its bounds by a hundredth of the range."""
    return torch.logit(((roughness - LEAST_ROUGHNESS) / (1 - LEAST_ROUGHNESS)).clamp(0.01, 0.99))


def linear(photo: Tensor) -> Tensor:
    """A photograph as tasks keep it, uint8 sRGB of any shape, in linear RGB."""
    levels = srgb_to_linear(torch.arange(256, device=photo.device) / 255)  # as a large photograph has many times
    return levels[photo.int()]


def pooled(maps: Tensor, size: Sequence[int]) -> Tensor:
    """Maps [..., 10, H, W] at another size, normals of unit length."""
    normal, rest = adaptive_avg_pool2d(maps, (size[0], size[1])).split((3, 7), -3)
    return torch.cat([of_length_1(normal), rest], -3)


def of_length_1(vectors: Tensor) -> Tensor:
    """Vectors [..., 3, H, W] of length 1; many times as fast as torch's own if channels come first."""
    return vectors * vectors.square().sum(-3, keepdim=True).clamp_min(1e-24).rsqrt()


def differences(maps: Maps, target: Maps) -> list[Tensor]:
    """Of diffuse and specular colour at gamma 2.2, of roughness and of normals, [T, C, H, W] each."""
    colours = [_shades(each) - _shades(other) for each, other in zip(maps[:2], target[:2], strict=True)]
    return [*colours, maps.roughness - target.roughness, maps.normal - target.normal]


def _shades(colour: Tensor) -> Tensor:
    return (colour + 1e-3) ** (1 / 2.2)


class Flash(NamedTuple):
    """A flash beside the lens, and the camera's exposure.

    Attributes:
        place: [T, 3].
        gain: [T, 1], its intensity, as `metapp.appearance.flash.render` has it.
        eye: position of the camera, [T, 3] or [3].
    """

    place: Tensor
    gain: Tensor
    eye: Tensor


def flash_of(flash: Tensor) -> Flash:
    """Of its description [T, FLASH], any numbers: aside, higher, brighter; zeros say beside the lens, where white is 1.

    How bright white is right below the flash does not depend on its height, since exposure makes up for that.
    """
    higher = torch.exp(UP * flash[:, 2:3])
    place = torch.cat([ACROSS * flash[:, :2], camera_distance() * higher], 1)
    eye = camera(dtype=flash.dtype, device=flash.device)
    return Flash(place, torch.exp(BRIGHT * flash[:, 3:4]) * higher * higher, eye)


def photographed(maps: Maps, flash: Flash, place: Tensor | None = None) -> Tensor:
    """Radiance [T, 3, H, W] of maps [T, ...] under a flash; of parts of the patch at positions `place` [T, 2, H, W]."""
    like = maps.diffuse
    if place is None:
        place = positions(*like.shape[-2:], dtype=like.dtype, device=like.device)
    return render(maps, place, flash.place, flash.eye, intensity=flash.gain)


def oblique_pairs(rng: Generator, shape: tuple[int, ...]) -> Tensor:
    """Places of a light and of a viewer who know nothing of each other, [*shape, 2, 3]."""
    return camera_distance() * _directions(rng, (*shape, 2))


def mirroring_pairs(rng: Generator, shape: tuple[int, ...]) -> Tensor:
    """Places of a light and of a viewer who sees it mirrored somewhere in a smooth patch, [*shape, 2, 3]."""
    centre = 1.6 * uniform(rng, *shape, 2) - 0.8
    centre = torch.cat([centre, torch.zeros_like(centre[..., :1])], -1)
    towards = _directions(rng, shape)
    mirrored = towards * towards.new_tensor([-1.0, -1.0, 1.0])
    return torch.stack([centre + camera_distance() * each for each in (towards, mirrored)], -2)


def _directions(rng: Generator, shape: tuple[int, ...]) -> Tensor:
    """Unit vectors [*shape, 3], evenly spread in solid angle about the normal, no more oblique than LEAST_COSINE."""
    z, turn = uniform(rng, 2, *shape)
    z, phi = LEAST_COSINE + (1 - LEAST_COSINE) * z, 2 * math.pi * turn
    sine = (1 - z * z).sqrt()
    return torch.stack([sine * phi.cos(), sine * phi.sin(), z], -1)


def inputs_of(photo: Tensor) -> Tensor:
    """The field's inputs at each pixel of linear photographs [T, 3, H, W]: [T, 8, H, W].

    The log of its colour, how brightness differs from and among its neighbours, and its position. Neighbours are as far
    apart in the patch whatever the resolution, so that a field that was fitted at one works at others.
    """
    logs = (photo + 0.02).log()
    side = max(1, min(photo.shape[-2:]) // STRIDE)
    wide = pad(logs.mean(1, keepdim=True), (side, side, side, side), mode="replicate")
    middle, after = slice(side, -side), slice(2 * side, None)
    before = slice(None, -2 * side)
    left, right = wide[..., middle, before], wide[..., middle, after]
    above, below = wide[..., before, middle], wide[..., after, middle]
    here = wide[..., middle, middle]
    contrasts = [right - left, above - below, 4 * here - left - right - above - below]
    place = positions(*photo.shape[-2:], dtype=photo.dtype, device=photo.device).expand(len(photo), -1, -1, -1)
    return torch.cat([logs / 1.5 + 1, *contrasts, place], 1)
