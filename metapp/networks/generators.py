"""Generators of pictures from noise: a U-Net, and a pyramid each of whose levels makes a picture of another size.

They compute several tasks at once and know neither features nor losses.
"""

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

    All convolutions pad circularly, so that its output tiles. Sides of the noise are multiples of `2 ** (levels - 1)`.

    Attributes:
        width: the number of channels of the finest level; each level down doubles them, up to four times as many.
        levels: the number of resolutions, each half of the one before.
        noise: the number of channels of the noise that it reads.
        code: the length of the code z that styles its channels.
        outputs: the number of channels of its output.
    """

    width: int
    levels: int = 4
    noise: int = 8
    code: int = 32
    outputs: int = 3

    @property
    def side_step(self) -> int:
        """The number of px of which sides of pictures are multiples, so that all levels have whole sides."""
        result: int = 2 ** (self.levels - 1)
        return result

    @property
    def output_shift(self) -> str:
        """The name of the parameter [T, outputs] that is added to each texel of the output."""
        return "out.shift"

    def level_channels(self, level: int) -> int:
        """Return the number of channels of a level, of which 0 is the finest."""
        result: int = self.width * min(2**level, 4)
        return result

    def layer_sizes(self) -> dict[str, tuple[int, int]]:
        """Return the numbers of channels that each 3x3 convolution reads and makes, by its name, in order of use."""
        down = {"down0": (self.noise, self.level_channels(0))}
        for level in range(1, self.levels):
            down[f"down{level}"] = (self.level_channels(level - 1), self.level_channels(level))
        up = {
            f"up{level}": (self.level_channels(level + 1) + self.level_channels(level), self.level_channels(level))
            for level in reversed(range(self.levels - 1))
        }
        return down | up

    def init(self, rng: Generator, count: int) -> Params:
        """Draw random parameters of `count` networks, each tensor [count, ...]."""
        theta = init_styled(rng, count, self.code, self.layer_sizes())
        kernel = draw_normal(rng, count, self.outputs, self.level_channels(0), 1, 1)
        theta["out.kernel"] = kernel * math.sqrt(1 / self.level_channels(0))
        theta["out.shift"] = torch.zeros(count, self.outputs, device=rng.device)
        return theta

    def __call__(self, theta: Params, noise: Tensor) -> Tensor:
        """Generate maps from noise.

        Args:
            theta: the parameters of T networks, which :meth:`init` draws.
            noise: standard normal numbers [T, B, noise, H, W].

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
            # grouped convolutions want the channels of one task side by side
            parts = [part.unflatten(1, (tasks, -1)) for part in (above, skips[level])]
            x = apply_styled(theta, f"up{level}", torch.cat(parts, 2).flatten(1, 2))
        x = conv2d(x, theta["out.kernel"].flatten(0, 1), theta["out.shift"].flatten(), groups=tasks)
        result: Tensor = x.unflatten(1, (tasks, self.outputs)).transpose(0, 1)
        return result


class Pyramid(NamedTuple):
    """Noise-to-image convolutions from coarse to fine with noise at each level (Ulyanov et al. 2016).

    Each level doubles the resolution, reads noise of its size and corrects the enlarged picture of the level above
    (Karras et al. 2020), so that coarse levels alone make a smaller picture of equal structures. All convolutions pad
    circularly, so that its output tiles. Sides of the noise are multiples of `2 ** (levels - 1 - finest)`.

    Attributes:
        width: the number of channels of the finest level; each level up doubles them, up to four times as many.
        levels: the number of resolutions, each half of the one before.
        noise: the number of channels of the noise at each level.
        code: the length of the code z that styles its channels.
        outputs: the number of channels of its output.
        finest: the level whose picture is the output, 0 for the whole size.
        quilt: the number of channels of the quilt, a picture of pieces of the exemplar, which each level reads beside
            noise; 0 if there is none.
    """

    width: int
    levels: int = 6
    noise: int = 8
    code: int = 32
    outputs: int = 3
    finest: int = 0
    quilt: int = 0

    @property
    def side_step(self) -> int:
        """The number of px of which sides of pictures are multiples, so that all levels have whole sides."""
        result: int = 2 ** (self.levels - 1)
        return result

    @property
    def output_shift(self) -> str:
        """The name of the parameter [T, outputs] that the coarsest level adds to each texel of the output."""
        return f"out{self.levels - 1}.shift"

    def level_channels(self, level: int) -> int:
        """Return the number of channels of a level, of which 0 is the finest; it is 0 above the coarsest."""
        result: int = self.width * min(2**level, 4) if level < self.levels else 0
        return result

    def layer_sizes(self) -> dict[str, tuple[int, int]]:
        """Return the numbers of channels that each 3x3 convolution reads and makes, by its name, in order of use."""
        sizes = {}
        for level in reversed(range(self.levels)):
            outputs = self.level_channels(level)
            sizes[f"join{level}"] = (self.level_channels(level + 1) + self.noise + self.quilt, outputs)
            sizes[f"draw{level}"] = (outputs, outputs)
        return sizes

    def init(self, rng: Generator, count: int) -> Params:
        """Draw random parameters of `count` networks, each tensor [count, ...]."""
        theta = init_styled(rng, count, self.code, self.layer_sizes())
        for level in range(self.levels):
            inputs = self.level_channels(level)
            kernel = draw_normal(rng, count, self.outputs, inputs, 1, 1)
            theta[f"out{level}.kernel"] = kernel * (0.5 / math.sqrt(inputs))
            theta[f"out{level}.shift"] = torch.zeros(count, self.outputs, device=rng.device)
        return theta

    def __call__(self, theta: Params, noise: Tensor, quilts: Tensor | None = None) -> Tensor:
        """Generate maps from noise.

        Args:
            theta: the parameters of T networks, which :meth:`init` draws.
            noise: standard normal numbers [T, B, noise, H, W], of the size of the level `finest`.
            quilts: quilts of that size, [T, B, quilt, H, W]; None if the network reads none.

        Returns:
            Values before any range is imposed, [T, B, outputs, H, W].
        """
        tasks = len(noise)
        inputs = noise if quilts is None else torch.cat([noise, quilts], 2)
        gain = torch.ones(inputs.shape[2], 1, 1, dtype=noise.dtype, device=noise.device)
        gain[: self.noise] = 2  # so that the mean of four texels of noise has unit variance again
        inputs_by_level = [inputs.transpose(0, 1).flatten(1, 2)]
        gain = gain.repeat(tasks, 1, 1)
        for _ in range(self.finest + 1, self.levels):
            inputs_by_level.append(gain * avg_pool2d(inputs_by_level[-1], 2))
        x, picture = None, None
        for level in reversed(range(self.finest, self.levels)):
            noise = inputs_by_level[level - self.finest]
            is_large = noise.shape[-2] > layers.STRIP_ROWS and not torch.is_grad_enabled()
            apply_layer = apply_styled_by_rows if is_large else apply_styled
            x = apply_layer(theta, f"draw{level}", apply_layer(theta, f"join{level}", noise, x))
            kernel, shift = theta[f"out{level}.kernel"], theta[f"out{level}.shift"]
            addition = conv2d(x, kernel.flatten(0, 1), shift.flatten(), groups=tasks)
            picture = addition if picture is None else enlarge_periodic(picture) + addition
        assert picture is not None
        result: Tensor = picture.unflatten(1, (tasks, self.outputs)).transpose(0, 1)
        return result
