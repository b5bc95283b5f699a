"""The generator that textures and stationary svBRDFs share: a U-Net from noise to maps, conditioned by a code."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, conv2d, instance_norm, interpolate, leaky_relu, pad

from metapp.task import Params

SLOPE = 0.2


class UNet(NamedTuple):
    """A noise-to-image U-Net with adaptive instance normalisation (Ulyanov et al. 2016; Henzler et al. 2020, 2021).

    All convolutions pad circularly, so that what it makes tiles, at any size that `2 ** (levels - 1)` divides.

    Attributes:
        width: channels of the finest level; each level down doubles them, up to four times as many.
        levels: resolutions, each half of the one before.
        noise: channels of the noise it starts from.
        code: length of z.
        outputs: channels of what it makes.
    """

    width: int
    levels: int = 4
    noise: int = 8
    code: int = 32
    outputs: int = 3

    def channels(self, level: int) -> int:
        """Channels at a level, 0 the finest."""
        return self.width * min(2**level, 4)

    def layers(self) -> dict[str, tuple[int, int]]:
        """(inputs, outputs) of each 3x3 convolution, in order of use."""
        down = {"down0": (self.noise, self.channels(0))}
        for level in range(1, self.levels):
            down[f"down{level}"] = (self.channels(level - 1), self.channels(level))
        up = {
            f"up{level}": (self.channels(level + 1) + self.channels(level), self.channels(level))
            for level in reversed(range(self.levels - 1))
        }
        return down | up

    def init(self, rng: Generator, count: int) -> Params:
        """Random parameters of `count` networks: each tensor [count, ...]."""

        def normal(*shape: int, scale: float) -> Tensor:
            return torch.randn(count, *shape, generator=rng, device=rng.device) * scale

        theta = {"z": normal(self.code, scale=1.0)}
        for name, (inputs, outputs) in self.layers().items():
            theta[f"{name}.kernel"] = normal(outputs, inputs, 3, 3, scale=math.sqrt(2 / (9 * inputs)))
            theta[f"{name}.style"] = normal(2 * outputs, self.code, scale=0.3 / math.sqrt(self.code))
            theta[f"{name}.shift"] = torch.zeros(count, 2 * outputs, device=rng.device)
        theta["out.kernel"] = normal(self.outputs, self.channels(0), 1, 1, scale=math.sqrt(1 / self.channels(0)))
        theta["out.shift"] = torch.zeros(count, self.outputs, device=rng.device)
        return theta

    def __call__(self, theta: Params, noise: Tensor) -> Tensor:
        """Maps from noise.

        Args:
            theta: parameters of T networks, as of `init`.
            noise: standard normal, [T, B, noise, H, W].

        Returns:
            Values before any range is imposed, [T, B, outputs, H, W].
        """
        tasks, batch, _, height, width = noise.shape
        x = noise.transpose(0, 1).reshape(batch, -1, height, width)
        skips = []
        for level in range(self.levels):
            x = self._layer(theta, f"down{level}", avg_pool2d(x, 2) if level else x)
            skips.append(x)
        for level in reversed(range(self.levels - 1)):
            above = interpolate(x, scale_factor=2, mode="nearest")
            # channels of one task lie together, as grouped convolutions want them
            parts = [part.unflatten(1, (tasks, -1)) for part in (above, skips[level])]
            x = self._layer(theta, f"up{level}", torch.cat(parts, 2).flatten(1, 2))
        x = conv2d(x, theta["out.kernel"].flatten(0, 1), theta["out.shift"].flatten(), groups=tasks)
        return x.unflatten(1, (tasks, self.outputs)).transpose(0, 1)

    def _layer(self, theta: Params, name: str, x: Tensor) -> Tensor:
        kernel = theta[f"{name}.kernel"]
        x = conv2d(pad(x, (1, 1, 1, 1), mode="circular"), kernel.flatten(0, 1), groups=kernel.shape[0])
        style = torch.baddbmm(theta[f"{name}.shift"][..., None], theta[f"{name}.style"], theta["z"][..., None])
        gain, shift = style[..., 0].chunk(2, 1)
        x = instance_norm(x) * (1 + gain.reshape(-1, 1, 1)) + shift.reshape(-1, 1, 1)
        return leaky_relu(x, SLOPE)
