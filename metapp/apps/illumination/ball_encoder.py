"""General's encoder: the photograph of a sphere to the code of a map, the sphere's material and the camera."""

from __future__ import annotations

import functools

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, conv1d, conv2d, grid_sample, leaky_relu, normalize, pad

from metapp.appearance.latlong import texel_directions
from metapp.learning.task import Params
from metapp.networks.layers import add_layer, apply_dense

LEAKY_SLOPE = 0.1
PHOTO_PX = 64  # side of a photograph
PHOTO_CHANNELS = ((3, 24), (24, 48), (48, 64), (64, 96))  # channels of the layers that look at the photograph as it is
OUTLINE_NUMBERS = 32  # numbers that describe the photograph as a whole
SPHERE_CHANNELS = 64  # channels on the sphere of directions
SPHERE_STRIDES = (1, 2, 4, 8, 1)  # how far apart the texels are that its layers look at, so that all see all around


def init_reader(rng: Generator, code: int, body: int) -> Params:
    """Random parameters for codes of a length, and for `body` numbers of the sphere's material and the camera."""
    reader: Params = {}
    layer = functools.partial(add_layer, reader, rng)

    for i, (inputs, outputs) in enumerate(PHOTO_CHANNELS):
        layer(f"photo{i}", outputs, inputs, 3, 3)
    layer("whole", 2 * OUTLINE_NUMBERS, PHOTO_CHANNELS[-1][1] * (PHOTO_PX // 2 ** len(PHOTO_CHANNELS)) ** 2)
    layer("outline", OUTLINE_NUMBERS, 2 * OUTLINE_NUMBERS)
    layer("body", body, 2 * OUTLINE_NUMBERS, gain=0.1)
    layer("around0", SPHERE_CHANNELS, 2 * 6 + 3, 3, 3)
    layer("around0.whole", SPHERE_CHANNELS, OUTLINE_NUMBERS)
    for i in range(1, 1 + len(SPHERE_STRIDES)):
        layer(f"around{i}", SPHERE_CHANNELS, SPHERE_CHANNELS, 3, 3, gain=1.0)
        layer(f"around{i}.row", SPHERE_CHANNELS, SPHERE_CHANNELS, 1, gain=0.5)
    layer("code", code, SPHERE_CHANNELS, 1, 1, gain=0.3)
    return reader


def read_ball_photos(reader: Params, photos: Tensor, rows: int, columns: int) -> tuple[Tensor, Tensor]:
    """The code [T, code, rows, columns] and the body [T, body] of photographs [T, 3, PHOTO_PX, PHOTO_PX] in [0, 1].

    Two views of one photograph: as it is, and unwrapped to where its pixels mirror from and where they face. Each
    direction also sees the other side of the sphere at its elevation, and its row's mean: most light behind
    a sphere resembles the light before it.
    """
    x = photos - 0.5
    for i in range(len(PHOTO_CHANNELS)):
        kernel, shift = reader[f"photo{i}.kernel"], reader[f"photo{i}.shift"]
        x = leaky_relu(conv2d(x, kernel, shift, stride=2, padding=1), LEAKY_SLOPE)
    whole = leaky_relu(apply_dense(reader, "whole", x.flatten(1)), LEAKY_SLOPE)
    x = unwrap_photos(photos, 2 * rows, 2 * columns).contiguous(memory_format=torch.channels_last)
    outline = apply_dense(reader, "around0.whole", apply_dense(reader, "outline", whole))[..., None, None]
    x = avg_pool2d(leaky_relu(_around(reader, "around0", x) + outline, LEAKY_SLOPE), 2)
    for i, stride in enumerate(SPHERE_STRIDES, 1):
        row = conv1d(x.mean(3), reader[f"around{i}.row.kernel"], reader[f"around{i}.row.shift"])[..., None]
        x = x + leaky_relu(_around(reader, f"around{i}", x, stride) + row, LEAKY_SLOPE)
    return conv2d(x, reader["code.kernel"], reader["code.shift"]), apply_dense(reader, "body", whole)


def unwrap_photos(photos: Tensor, height: int, width: int) -> Tensor:
    """Photographs [T, 3, S, S] in [0, 1], less 0.5, on the sphere of directions.

    Returns:
        [T, 15, height, width]: a photograph at the pixels that mirror each direction, and that face it; the same
        of the direction's image in the picture's plane; and the directions.
    """
    grids, towards = _places(height, width)
    views = [
        grid_sample(photos - 0.5, grid.to(photos).expand(len(photos), -1, -1, -1), align_corners=False)
        for grid in grids
    ]
    return torch.cat([*views, towards.to(photos).expand(len(photos), -1, -1, -1)], 1)


@functools.lru_cache(maxsize=4)
def _places(height: int, width: int) -> tuple[list[Tensor], Tensor]:
    """Where the picture of a sphere, seen from +z, mirrors each direction and where it faces it, as grid_sample does.

    Directions that face away from the viewer are looked up at the rim.
    """
    towards = texel_directions(height, width)
    grids = []
    for each in (towards, towards * torch.tensor([1.0, 1.0, -1.0])[:, None, None]):
        mirror = normalize(each + torch.tensor([0.0, 0.0, 1.0])[:, None, None], dim=0)
        rim = normalize(each[:2], dim=0)
        facing = torch.where(each[2] >= 0, each[:2], rim)
        # a pixel inside, where the rim is
        grids += [0.97 * torch.stack([place[0], -place[1]], -1) for place in (mirror, facing)]
    return grids, towards


def _around(encoder: Params, name: str, x: Tensor, stride: int = 1) -> Tensor:
    """A 3x3 convolution, of texels so far apart, that goes around the horizon and ends at the poles."""
    x = pad(pad(x, (stride, stride, 0, 0), mode="circular"), (0, 0, stride, stride), mode="replicate")
    return conv2d(x, encoder[f"{name}.kernel"], encoder[f"{name}.shift"], dilation=stride)
