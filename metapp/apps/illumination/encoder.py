"""General's encoder: the photograph of a sphere to the code of a map, the sphere's material and the camera."""

from __future__ import annotations

import functools
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, conv1d, conv2d, grid_sample, leaky_relu, normalize, pad

from metapp.appearance.latlong import directions
from metapp.learning.task import Params
from metapp.networks.layers import add_layer, dense

SLOPE = 0.1
DIRECT = ((3, 24), (24, 48), (48, 64), (64, 96))  # channels of the layers that look at the photograph as it is
OUTLINE = 32  # numbers that describe the photograph as a whole
AROUND = 64  # channels on the sphere of directions
STRIDES = (1, 2, 4, 8, 1)  # how far apart the texels are that its layers look at, so that all see all around


class Encoder(NamedTuple):
    """Two views of one photograph: as it is, and unwrapped to where its pixels mirror from and where they face.

    Each direction also sees what is on the other side of the sphere at its elevation, and its row's mean: most light
    behind a sphere resembles what is before it.

    Attributes:
        height, width: of the unwrapped views, twice the code's grid.
        code: length of the code in a cell.
        body: numbers that describe the sphere's material and the camera.
        photo: side of the photograph, px.
    """

    height: int
    width: int
    code: int
    body: int
    photo: int = 64

    def init(self, rng: Generator) -> Params:
        """Random parameters."""
        encoder: Params = {}
        layer = functools.partial(add_layer, encoder, rng)

        for i, (inputs, outputs) in enumerate(DIRECT):
            layer(f"photo{i}", outputs, inputs, 3, 3)
        layer("whole", 2 * OUTLINE, DIRECT[-1][1] * (self.photo // 2 ** len(DIRECT)) ** 2)
        layer("outline", OUTLINE, 2 * OUTLINE)
        layer("body", self.body, 2 * OUTLINE, gain=0.1)
        layer("around0", AROUND, 2 * 6 + 3, 3, 3)
        layer("around0.whole", AROUND, OUTLINE)
        for i in range(1, 1 + len(STRIDES)):
            layer(f"around{i}", AROUND, AROUND, 3, 3, gain=1.0)
            layer(f"around{i}.row", AROUND, AROUND, 1, gain=0.5)
        layer("code", self.code, AROUND, 1, 1, gain=0.3)
        return encoder

    def __call__(self, encoder: Params, photos: Tensor) -> tuple[Tensor, Tensor]:
        """The code [T, code, height / 2, width / 2] and the body [T, body] of photographs [T, 3, S, S] in [0, 1]."""
        x = photos - 0.5
        for i in range(len(DIRECT)):
            kernel, shift = encoder[f"photo{i}.kernel"], encoder[f"photo{i}.shift"]
            x = leaky_relu(conv2d(x, kernel, shift, stride=2, padding=1), SLOPE)
        whole = leaky_relu(dense(encoder, "whole", x.flatten(1)), SLOPE)
        x = unwrapped(photos, self.height, self.width).contiguous(memory_format=torch.channels_last)
        outline = dense(encoder, "around0.whole", dense(encoder, "outline", whole))[..., None, None]
        x = avg_pool2d(leaky_relu(_around(encoder, "around0", x) + outline, SLOPE), 2)
        for i, stride in enumerate(STRIDES, 1):
            row = conv1d(x.mean(3), encoder[f"around{i}.row.kernel"], encoder[f"around{i}.row.shift"])[..., None]
            x = x + leaky_relu(_around(encoder, f"around{i}", x, stride) + row, SLOPE)
        code = conv2d(x, encoder["code.kernel"], encoder["code.shift"])
        return code, dense(encoder, "body", whole)


def unwrapped(photos: Tensor, height: int, width: int) -> Tensor:
    """Photographs [T, 3, S, S] in [0, 1], less 0.5, on the sphere of directions.

    Returns:
        [T, 15, height, width]: what a photograph shows where it mirrors each direction, and where it faces it; the same
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

    What faces away from the viewer is looked up at the rim.
    """
    towards = directions(height, width)
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
