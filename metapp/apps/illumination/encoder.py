"""General's encoder: the photograph of a sphere to the code of a map, the sphere's material and the camera."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, conv2d, grid_sample, leaky_relu, normalize, pad

from metapp.latlong import directions
from metapp.task import Params

SLOPE = 0.1
DIRECT = ((3, 24), (24, 48), (48, 64), (64, 96))  # channels of the layers that look at the photograph as it is
OUTLINE = 32  # what is said of the photograph as a whole
AROUND = 64  # channels on the sphere of directions


class Encoder(NamedTuple):
    """Two views of one photograph: as it is, and unwrapped to where its pixels mirror from and where they face.

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

        def layer(name: str, outputs: int, *inputs: int, gain: float = math.sqrt(2)) -> None:
            noise = torch.randn(outputs, *inputs, generator=rng, device=rng.device)
            encoder[f"{name}.kernel"] = noise * gain / math.sqrt(math.prod(inputs))
            encoder[f"{name}.shift"] = torch.zeros(outputs, device=rng.device)

        for i, (inputs, outputs) in enumerate(DIRECT):
            layer(f"photo{i}", outputs, inputs, 3, 3)
        layer("whole", 2 * OUTLINE, DIRECT[-1][1] * (self.photo // 2 ** len(DIRECT)) ** 2)
        layer("outline", OUTLINE, 2 * OUTLINE)
        layer("body", self.body, 2 * OUTLINE, gain=0.1)
        layer("around0", AROUND, 6 + 3 + OUTLINE, 3, 3)
        for i in (1, 2, 3):
            layer(f"around{i}", AROUND, AROUND, 3, 3, gain=1.0)
        layer("code", self.code, AROUND, 1, 1, gain=0.3)
        return encoder

    def __call__(self, encoder: Params, photos: Tensor) -> tuple[Tensor, Tensor]:
        """The code [T, code, height / 2, width / 2] and the body [T, body] of photographs [T, 3, S, S] in [0, 1]."""
        x = photos - 0.5
        for i in range(len(DIRECT)):
            kernel, shift = encoder[f"photo{i}.kernel"], encoder[f"photo{i}.shift"]
            x = leaky_relu(conv2d(x, kernel, shift, stride=2, padding=1), SLOPE)
        whole = leaky_relu(_dense(encoder, "whole", x.flatten(1)), SLOPE)
        outline = _dense(encoder, "outline", whole)[..., None, None].expand(-1, -1, self.height, self.width)
        x = torch.cat([unwrapped(photos, self.height, self.width), outline], 1)
        x = avg_pool2d(leaky_relu(_around(encoder, "around0", x), SLOPE), 2)
        for i in (1, 2, 3):
            x = x + leaky_relu(_around(encoder, f"around{i}", x), SLOPE)
        code = conv2d(x, encoder["code.kernel"], encoder["code.shift"])
        return code, _dense(encoder, "body", whole)


def unwrapped(photos: Tensor, height: int, width: int) -> Tensor:
    """Photographs [T, 3, S, S] in [0, 1], less 0.5, on the sphere of directions.

    Returns:
        [T, 9, height, width]: what a photograph shows where it mirrors each direction, and where it faces it; and the
        directions.
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
    mirror = normalize(towards + torch.tensor([0.0, 0.0, 1.0])[:, None, None], dim=0)
    rim = normalize(towards[:2], dim=0)
    facing = torch.where(towards[2] >= 0, towards[:2], rim)
    # a pixel inside, where the rim is
    grids = [0.97 * torch.stack([each[0], -each[1]], -1) for each in (mirror, facing)]
    return grids, towards


def _dense(encoder: Params, name: str, x: Tensor) -> Tensor:
    return x @ encoder[f"{name}.kernel"].T + encoder[f"{name}.shift"]


def _around(encoder: Params, name: str, x: Tensor) -> Tensor:
    """A 3x3 convolution that goes around the horizon and ends at the poles."""
    x = pad(pad(x, (1, 1, 0, 0), mode="circular"), (0, 0, 1, 1), mode="replicate")
    return conv2d(x, encoder[f"{name}.kernel"], encoder[f"{name}.shift"])
