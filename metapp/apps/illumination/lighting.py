"""What the parameters of a fit of illumination mean: an environment map, and a ball in its light before a camera.

Fits of a map leave ball and camera as they are. They have these parameters all the same, so that General predicts the
parameters of all fits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import softmax
from typing_extensions import override

from metapp.appearance.latlong import texel_directions
from metapp.appearance.photograph import CameraCurves, SphereMaterials, develop, render_material_spheres
from metapp.apps.illumination.suns import add_suns, join_suns
from metapp.learning.components import Decoder
from metapp.learning.task import Params
from metapp.networks.field import LocalField

BALL_AND_CAMERA_NUMBERS = 10  # numbers that describe a sphere's material and a camera
BALL_AND_CAMERA_GAIN = (
    100  # factor of these numbers, so that few steps at a network's rate find them; else the map would absorb them
)
BALL_ROUGHNESSES = (0.25, 0.42, 0.7)  # roughnesses of the lobes that a sphere's gloss is mixed of


class Lighting(NamedTuple):
    """Light from all directions, and a ball in it that a camera photographs.

    Attributes:
        maps: linear radiance [T, 3, H, W] at any scale.
        ball_and_camera: unbounded numbers [T, BALL_AND_CAMERA_NUMBERS], see :func:`decode_ball_and_camera`.
    """

    maps: Tensor
    ball_and_camera: Tensor

    def photograph(self, side: int) -> Tensor:
        """Return the photographs of the balls through the cameras, display values [T, 3, side, side]."""
        material, camera = decode_ball_and_camera(self.ball_and_camera)
        return develop(render_material_spheres(self.maps, material, side, BALL_ROUGHNESSES), camera)


@dataclass(frozen=True)
class LightField(Decoder[Lighting, Any]):
    """The decoder of environment maps: a field of directions, and the suns among a fit's parameters, if there are any.

    Attributes:
        network: the field, whose outputs are logs of radiance.
    """

    network: LocalField

    @property
    @override
    def is_periodic(self) -> bool:
        return self.network.periodic

    @override
    def init(self, rng: Generator, count: int) -> Params:
        ball = torch.zeros(count, BALL_AND_CAMERA_NUMBERS, device=rng.device)
        return self.network.init(rng, count) | {"body": ball}

    @override
    def __call__(self, theta: Params, seen: Any = None) -> Lighting:
        network, z = self.network, theta["z"]
        directions = texel_directions(network.height, network.width, dtype=z.dtype, device=z.device)
        maps = network(theta, directions.expand(len(z), -1, -1, -1)).clamp_max(16).exp()
        maps = add_suns(maps, join_suns(theta)) if "suns.light" in theta else maps
        return Lighting(maps, BALL_AND_CAMERA_GAIN * theta["body"])

    def resize(self, height: int, width: int) -> LightField:
        """Return the decoder of maps of another size, at which its network can be evaluated, too."""
        return replace(self, network=self.network._replace(height=height, width=width))


def decode_ball_and_camera(numbers: Tensor) -> tuple[SphereMaterials, CameraCurves]:
    """Return the materials of balls, and the cameras, that unbounded numbers [T, BALL_AND_CAMERA_NUMBERS] describe."""
    material = SphereMaterials(
        torch.sigmoid(numbers[:, :3] + 1), torch.sigmoid(numbers[:, 3] - 1), softmax(numbers[:, 4:7], 1)
    )
    return material, CameraCurves(
        torch.exp(numbers[:, 7]), torch.exp(0.3 * numbers[:, 8]), 0.5 * torch.sigmoid(numbers[:, 9])
    )
