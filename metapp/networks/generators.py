"""Generators of pictures from noise: a U-Net, and a pyramid whose levels each make a picture of their own size."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, conv2d, interpolate

from metapp.learning.random_tensors import draw_normal
from metapp.learning.task import Params
from metapp.networks import layers
from metapp.networks.layers import apply_styled, apply_styled_by_rows, enlarge_periodic, init_styled


class UNet(NamedTuple):
    """A noise-to-image U-Net with adaptive instance normalisation (Ulyanov et al. 2016; Henzler et al. 2020, 2021).

    All convolutions pad circularly, so that its output tiles, at any size that `2 ** (levels - 1)` divides.

    Attributes:
        width: channels of the finest level; each level down doubles them, up to four times as many.
        levels: resolutions, each half of the one before.
        noise: channels of its input noise.
        code: length of z.
        outputs: channels of its output.
    """

    width: int
    levels: int = 4
    noise: int = 8
    code: int = 32
    outputs: int = 3

    @property
    def has_layout(self) -> bool:
        """False: it reads no layout."""
        return False

    @property
    def offset(self) -> str:
        """The parameter [T, outputs] that is added to all that it makes."""
        return "out.shift"

    def channels(self, level: int) -> int:
        """Channels at a level, 0 the finest."""
        result: int = self.width * min(2**level, 4)
        return result

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
        theta = init_styled(rng, count, self.code, self.layers())
        kernel = draw_normal(rng, count, self.outputs, self.channels(0), 1, 1)
        theta["out.kernel"] = kernel * math.sqrt(1 / self.channels(0))
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
            x = apply_styled(theta, f"down{level}", avg_pool2d(x, 2) if level else x)
            skips.append(x)
        for level in reversed(range(self.levels - 1)):
            above = interpolate(x, scale_factor=2, mode="nearest")
            # channels of one task lie together, as grouped convolutions want them
            parts = [part.unflatten(1, (tasks, -1)) for part in (above, skips[level])]
            x = apply_styled(theta, f"up{level}", torch.cat(parts, 2).flatten(1, 2))
        x = conv2d(x, theta["out.kernel"].flatten(0, 1), theta["out.shift"].flatten(), groups=tasks)
        result: Tensor = x.unflatten(1, (tasks, self.outputs)).transpose(0, 1)
        return result


class Pyramid(NamedTuple):
    """Noise-to-image convolutions from coarse to fine with noise at each level (Ulyanov et al. 2016).

    Each level doubles the resolution, adds noise of its own and corrects the enlarged picture of the level above
    (Karras et al. 2020), so that coarse levels alone make a smaller picture of the same structures. All convolutions
    pad circularly: its output tiles, at any size that `2 ** (levels - 1)` divides.

    Attributes:
        width: channels of the finest level; each level up doubles them, up to four times as many.
        levels: resolutions, each half of the one before.
        noise: channels of the noise at each level.
        code: length of z.
        outputs: channels of its output.
        finest: the level whose picture it makes, 0 for the whole size.
        layout: channels of a coarse picture of the output, given at each level beside noise.
    """

    width: int
    levels: int = 6
    noise: int = 8
    code: int = 32
    outputs: int = 3
    finest: int = 0
    layout: int = 0

    @property
    def has_layout(self) -> bool:
        """True if it reads a layout."""
        return self.layout > 0

    @property
    def offset(self) -> str:
        """The parameter [T, outputs] that is added to all that it makes, by the coarsest level."""
        return f"out{self.levels - 1}.shift"

    def channels(self, level: int) -> int:
        """Channels at a level, 0 the finest; none above the coarsest."""
        result: int = self.width * min(2**level, 4) if level < self.levels else 0
        return result

    def layers(self) -> dict[str, tuple[int, int]]:
        """(inputs, outputs) of each 3x3 convolution, in order of use."""
        layers = {}
        for level in reversed(range(self.levels)):
            outputs = self.channels(level)
            layers[f"join{level}"] = (self.channels(level + 1) + self.noise + self.layout, outputs)
            layers[f"draw{level}"] = (outputs, outputs)
        return layers

    def init(self, rng: Generator, count: int) -> Params:
        """Random parameters of `count` networks: each tensor [count, ...]."""
        theta = init_styled(rng, count, self.code, self.layers())
        for level in range(self.levels):
            inputs = self.channels(level)
            kernel = draw_normal(rng, count, self.outputs, inputs, 1, 1)
            theta[f"out{level}.kernel"] = kernel * (0.5 / math.sqrt(inputs))
            theta[f"out{level}.shift"] = torch.zeros(count, self.outputs, device=rng.device)
        return theta

    def __call__(self, theta: Params, noise: Tensor, layout: Tensor | None = None) -> Tensor:
        """Maps from noise.

        Args:
            theta: parameters of T networks, as of `init`.
            noise: standard normal, [T, B, noise, H, W], of the size of the level `finest`.
            layout: of the noise's size, [T, B, layout, H, W]; None if the network reads none.

        Returns:
            Values before any range is imposed, [T, B, outputs, H, W].
        """
        tasks = len(noise)
        given = noise if layout is None else torch.cat([noise, layout], 2)
        gain = torch.ones(given.shape[2], 1, 1, dtype=noise.dtype, device=noise.device)
        gain[: self.noise] = 2  # noise is of unit variance again
        pooled = [given.transpose(0, 1).flatten(1, 2)]
        gain = gain.repeat(tasks, 1, 1)
        for _ in range(self.finest + 1, self.levels):
            pooled.append(gain * avg_pool2d(pooled[-1], 2))
        x, picture = None, None
        for level in reversed(range(self.finest, self.levels)):
            noise = pooled[level - self.finest]
            large = noise.shape[-2] > layers.STRIP_ROWS and not torch.is_grad_enabled()
            layer = apply_styled_by_rows if large else apply_styled
            x = layer(theta, f"draw{level}", layer(theta, f"join{level}", noise, x))
            kernel, shift = theta[f"out{level}.kernel"], theta[f"out{level}.shift"]
            addition = conv2d(x, kernel.flatten(0, 1), shift.flatten(), groups=tasks)
            picture = addition if picture is None else enlarge_periodic(picture) + addition
        assert picture is not None
        result: Tensor = picture.unflatten(1, (tasks, self.outputs)).transpose(0, 1)
        return result
