"""General's encoder of illumination: from a photographed sphere to a map's code, the sphere's material and the camera.

The encoder knows directions on the sphere. Of the network that makes a map of the code it knows the length of the code
alone.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, conv1d, conv2d, grid_sample, leaky_relu, normalize, pad
from typing_extensions import override

from metapp.appearance.latlong import texel_directions
from metapp.apps.illumination.lighting import BALL_AND_CAMERA_GAIN, BALL_AND_CAMERA_NUMBERS
from metapp.learning.task import Params
from metapp.networks.coded import CodeEncoder
from metapp.networks.field import LocalField
from metapp.networks.layers import add_layer, apply_dense

ENCODER_LEAKY_SLOPE = 0.1  # slope below 0 of the leaky ReLUs of the encoder
PHOTO_PX = 64  # side of a photograph
PHOTO_CHANNELS = ((3, 24), (24, 48), (48, 64), (64, 96))  # channels of the layers that read the photograph as it is
OUTLINE_NUMBERS = 32  # numbers that describe the photograph as a whole
SPHERE_CHANNELS = 64  # channels of the layers on the sphere of directions
SPHERE_STRIDES = (1, 2, 4, 8, 1)  # texels between the entries of these layers' kernels, which so see all around


@dataclass(frozen=True)
class BallEncoder(CodeEncoder):
    """The encoder of photographed spheres.

    Attributes:
        size: rows and columns of the code that it predicts.
    """

    size: tuple[int, int] = (16, 32)

    @override
    def init_reader(self, rng: Generator, network: LocalField) -> Params:
        return init_reader(rng, network.code)

    @override
    def read(self, reader: Params, photos: Tensor, network: LocalField) -> Params:
        photos = photos.to(next(iter(reader.values()))) / 255
        code, numbers = read_ball_photos(reader, photos, *self.size)
        # Code and numbers of ball and camera are multiplied by gains: the encoder predicts them as they are used.
        return {"z": code / network.gain, "body": numbers / BALL_AND_CAMERA_GAIN}


def init_reader(rng: Generator, code: int) -> Params:
    """Draw random parameters of the reader of photographs, which predicts a code of `code` numbers."""
    reader: Params = {}
    layer = functools.partial(add_layer, reader, rng)

    for i, (inputs, outputs) in enumerate(PHOTO_CHANNELS):
        layer(f"photo{i}", outputs, inputs, 3, 3)
    layer("whole", 2 * OUTLINE_NUMBERS, PHOTO_CHANNELS[-1][1] * (PHOTO_PX // 2 ** len(PHOTO_CHANNELS)) ** 2)
    layer("outline", OUTLINE_NUMBERS, 2 * OUTLINE_NUMBERS)
    layer("body", BALL_AND_CAMERA_NUMBERS, 2 * OUTLINE_NUMBERS, gain=0.1)
    layer("around0", SPHERE_CHANNELS, 2 * 6 + 3, 3, 3)
    layer("around0.whole", SPHERE_CHANNELS, OUTLINE_NUMBERS)
    for i in range(1, 1 + len(SPHERE_STRIDES)):
        layer(f"around{i}", SPHERE_CHANNELS, SPHERE_CHANNELS, 3, 3, gain=1.0)
        layer(f"around{i}.row", SPHERE_CHANNELS, SPHERE_CHANNELS, 1, gain=0.5)
    layer("code", code, SPHERE_CHANNELS, 1, 1, gain=0.3)
    return reader


def read_ball_photos(reader: Params, photos: Tensor, rows: int, columns: int) -> tuple[Tensor, Tensor]:
    """Read photographs of spheres: predict a map's code, the sphere's material and the camera.

    The networks read a photograph in two ways: as it is, for a summary of the whole, and unwrapped to the directions
    that its pixels mirror and face, for the code. Each direction also reads the other side of the sphere at its
    elevation and the mean of its row, since most light behind a sphere resembles the light before it.

    Args:
        reader: parameters of :func:`init_reader`.
        photos: display values [T, 3, PHOTO_PX, PHOTO_PX] in [0, 1].
        rows: rows of the code.
        columns: columns of the code.

    Returns:
        The code [T, code, rows, columns], and the numbers of material and camera, [T, BALL_AND_CAMERA_NUMBERS].
    """
    features = photos - 0.5
    for i in range(len(PHOTO_CHANNELS)):
        kernel, shift = reader[f"photo{i}.kernel"], reader[f"photo{i}.shift"]
        features = leaky_relu(conv2d(features, kernel, shift, stride=2, padding=1), ENCODER_LEAKY_SLOPE)
    summary = leaky_relu(apply_dense(reader, "whole", features.flatten(1)), ENCODER_LEAKY_SLOPE)
    features = unwrap_photos(photos, 2 * rows, 2 * columns).contiguous(memory_format=torch.channels_last)
    outline = apply_dense(reader, "around0.whole", apply_dense(reader, "outline", summary))[..., None, None]
    features = avg_pool2d(leaky_relu(_convolve_around(reader, "around0", features) + outline, ENCODER_LEAKY_SLOPE), 2)
    for i, stride in enumerate(SPHERE_STRIDES, 1):
        row_means = conv1d(features.mean(3), reader[f"around{i}.row.kernel"], reader[f"around{i}.row.shift"])[..., None]
        features = features + leaky_relu(
            _convolve_around(reader, f"around{i}", features, stride) + row_means, ENCODER_LEAKY_SLOPE
        )
    return conv2d(features, reader["code.kernel"], reader["code.shift"]), apply_dense(reader, "body", summary)


def unwrap_photos(photos: Tensor, height: int, width: int) -> Tensor:
    """Unwrap photographs of a sphere onto the sphere of directions.

    Args:
        photos: display values [T, 3, S, S] in [0, 1].
        height: rows of directions.
        width: columns of directions.

    Returns:
        [T, 15, height, width]: the photograph, less 0.5, at the pixel that mirrors a direction and at the pixel that
        faces it; both pixels of the direction's image behind the picture's plane; and the direction.
    """
    grids, directions = _locate_pixels(height, width)
    views = [
        grid_sample(photos - 0.5, grid.to(photos).expand(len(photos), -1, -1, -1), align_corners=False)
        for grid in grids
    ]
    return torch.cat([*views, directions.to(photos).expand(len(photos), -1, -1, -1)], 1)


@functools.lru_cache(maxsize=4)
def _locate_pixels(height: int, width: int) -> tuple[list[Tensor], Tensor]:
    """Return where the picture of a sphere, seen from +z, mirrors each direction, and where it faces it.

    Directions that face away from the viewer are looked up at the rim.

    Returns:
        Coordinates of pixels as grid_sample takes them, four grids [height, width, 2]: mirroring and facing pixels of
        each direction, then of its image behind the picture's plane; and the directions, [3, height, width].
    """
    directions = texel_directions(height, width)
    grids = []
    for towards in (directions, directions * torch.tensor([1.0, 1.0, -1.0])[:, None, None]):
        mirror = normalize(towards + torch.tensor([0.0, 0.0, 1.0])[:, None, None], dim=0)
        rim = normalize(towards[:2], dim=0)
        facing = torch.where(towards[2] >= 0, towards[:2], rim)
        # the rim is looked up a pixel inside
        grids += [0.97 * torch.stack([position[0], -position[1]], -1) for position in (mirror, facing)]
    return grids, directions


def _convolve_around(encoder: Params, name: str, features: Tensor, stride: int = 1) -> Tensor:
    """Convolve maps [T, C, H, W] by a 3x3 kernel of texels `stride` apart, around the horizon, ending at the poles."""
    features = pad(pad(features, (stride, stride, 0, 0), mode="circular"), (0, 0, stride, stride), mode="replicate")
    return conv2d(features, encoder[f"{name}.kernel"], encoder[f"{name}.shift"], dilation=stride)
