"""Data augmentation of whole materials: patches of any scale, relief beside other colours, photographed anew.

Beside packed maps [T, 10, S, S] go weights of the loss of diffuse colour, specular colour, roughness and normals,
`map_weights` [T, 4]: 0 where a training set lacks that map.
"""

from __future__ import annotations

import math

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d

from metapp.apps.svbrdf_nonstationary.maps import PIXEL_INPUTS, find_slopes, normalise, pixel_inputs, pool_maps
from metapp.apps.svbrdf_nonstationary.pretrained.patch import describe_patch
from metapp.apps.svbrdf_nonstationary.variants import (
    POLISHED_SHARE,
    RESTYLED_SHARES,
    change_some,
    crop_turned,
    draw_photos,
    draws_per_material,
    mix_materials,
    polish,
    recolour,
    restyle,
)
from metapp.learning.task import Batch

MIN_SIDE = 0.4  # shortest side of a photographed patch, over the side of the material's maps
SQUARE_SHARE = 0.5  # share of patches with sides parallel to the maps' sides, which may show all of the maps
FLATTENED_SHARE = 0.3  # share of materials that become nearly flat
LOG_FLATTENING = (-4.0, -0.7)  # range of the log of the factor of their slopes
WHOLE_SHARE = 0.4  # share of outer steps that see all of a patch, half as fine
FINER_SHARE = 0.5  # share of outer steps with two texels a pixel in a row: relief within a pixel widens highlights
EXCHANGED_SHARE = 0.3  # share of materials that get the relief of another one, so that colours say nothing of relief


def crop_pieces(maps: Tensor, side: int, rng: Generator) -> Tensor:
    """Cut patches [T, 10, side, side] out of maps [T, 10, S, S], anywhere, in any direction, half of them mirrored."""
    uniform, _ = draws_per_material(len(maps), rng)
    angle = 2 * math.pi * uniform()
    quarter_angle = (2 * angle / math.pi).round() * math.pi / 2
    angle = torch.where(uniform() < SQUARE_SHARE, quarter_angle, angle)
    widths = angle.cos().abs() + angle.sin().abs()  # of turned squares of side 1
    extent = torch.lerp(torch.full_like(widths, MIN_SIDE), 1 / widths, uniform())
    while 2 * side <= float(extent.min()) * maps.shape[-1]:  # patches need no finer maps
        maps = avg_pool2d(maps, 2)
    centre = (1 - extent * widths)[:, None] * (2 * uniform(2) - 1)
    return crop_turned(maps, side, angle, extent, centre, uniform(1, 1, 1) < 0.5, "border")


def flatten_relief(maps: Tensor, rng: Generator) -> Tensor:
    """Flatten the relief of materials [T, 10, S, S], so that their patterns are nearly all paint."""
    uniform, _ = draws_per_material(len(maps), rng)
    low, high = LOG_FLATTENING
    slopes = find_slopes(maps[:, :3]) * torch.exp(low + (high - low) * uniform(1, 1, 1))
    return torch.cat([normalise(torch.cat([slopes, torch.ones_like(slopes[:, :1])], 1)), maps[:, 3:]], 1)


def exchange_relief(maps: Tensor, map_weights: Tensor, rng: Generator) -> tuple[Tensor, Tensor]:
    """Give some materials [T, 10, S, S] the normals of the one before, with the weights [T, 4] of these normals."""
    uniform, _ = draws_per_material(len(maps), rng)
    is_exchanged = uniform(1, 1, 1) < EXCHANGED_SHARE
    normal = torch.where(is_exchanged, maps[:, :3].roll(1, 0), maps[:, :3])
    weight = torch.where(is_exchanged[:, :, 0, 0], map_weights[:, 3:].roll(1, 0), map_weights[:, 3:])
    return torch.cat([normal, maps[:, 3:]], 1), torch.cat([map_weights[:, :3], weight], 1)


def blend_materials(maps: Tensor, map_weights: Tensor, rng: Generator) -> tuple[Tensor, Tensor]:
    """Mix half of the materials [T, 10, S, S] with the one before; weights [T, 4] are the lower ones of both."""
    mixed = mix_materials(maps, rng)
    is_unmixed = (mixed[:, 3:] == maps[:, 3:]).flatten(1).all(1, keepdim=True)
    return mixed, torch.where(is_unmixed, map_weights, torch.minimum(map_weights, map_weights.roll(1, 0)))


def draw_variants(fine: Tensor, map_weights: Tensor, side: int, rng: Generator) -> Batch:
    """Draw a training batch: windows of photographs of augmented materials.

    Args:
        fine: packed maps [T, 10, S, S].
        map_weights: weights of the loss of their maps, [T, 4].
        side: of the windows, in px; photographs have twice the side.
        rng: draws all random numbers.

    Returns:
        `photo` [T, 3, side, side], linear; what `describe_patch` knows of the whole patch; `inputs` of the field,
        [T, PIXEL_INPUTS, side, side]; `maps` [T, 10, side, side]; `map_weights` [T, 4].
    """
    texels_per_pixel = 2 if draw_chance(FINER_SHARE, rng) else 1
    maps = change_some(restyle, crop_pieces(fine, texels_per_pixel * 2 * side, rng), RESTYLED_SHARES[0], rng)
    maps, map_weights = blend_materials(recolour(maps, rng), map_weights, rng)
    maps, map_weights = exchange_relief(change_some(restyle, maps, RESTYLED_SHARES[1], rng), map_weights, rng)
    maps = change_some(polish, change_some(flatten_relief, maps, FLATTENED_SHARE, rng), POLISHED_SHARE, rng)
    photo, maps = avg_pool2d(draw_photos(maps, rng), texels_per_pixel), pool_maps(maps, (2 * side, 2 * side))
    patch = describe_patch(photo)
    if draw_chance(WHOLE_SHARE, rng):
        photo, maps = avg_pool2d(photo, 2), pool_maps(maps, (side, side))
        inputs = pixel_inputs(photo)
    else:
        pictures = torch.cat([photo, pixel_inputs(photo), maps], 1)
        channels = (3, PIXEL_INPUTS, maps.shape[1])
        photo, inputs, maps = crop_windows(pictures, side, rng).split(channels, 1)
    return {"photo": photo, "inputs": inputs, "maps": maps, "map_weights": map_weights} | patch


def draw_chance(share: float, rng: Generator) -> bool:
    """Return True with a given probability."""
    return float(torch.rand(1, generator=rng, device=rng.device)) < share


def crop_windows(pictures: Tensor, side: int, rng: Generator) -> Tensor:
    """Cut a square [T, C, side, side] out of each picture [T, C, S, S], anywhere in it."""
    uniform, _ = draws_per_material(len(pictures), rng)
    corners = (uniform(2) * (pictures.shape[-1] - side + 1)).long().clamp_max(pictures.shape[-1] - side)
    squares = zip(pictures, corners.tolist(), strict=True)
    windows = [picture[:, row : row + side, column : column + side] for picture, (row, column) in squares]
    return torch.stack(windows)
