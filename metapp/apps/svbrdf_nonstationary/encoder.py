"""General's encoder: a U-Net from the flash photograph of a material to the code of its field, and to its flash."""

from __future__ import annotations

import functools
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool2d, conv2d, interpolate, leaky_relu

from metapp.learning.task import Params
from metapp.networks.layers import add_layer, convolved, dense

SLOPE = 0.1
LOOKED = 4  # cells a side of the coarsest level that the flash is looked for in
MOST = 8  # times the finest level's channels, at the coarsest


class Encoder(NamedTuple):
    """A U-Net whose levels all know the picture's mean (Ronneberger et al. 2015; Deschaintre et al. 2018).

    Attributes:
        inputs: channels of what is known of the pixels.
        width: channels of the finest level; each level down has twice as many, up to MOST times.
        code: length of the code in a pixel.
        flash: numbers that describe the flash.
        levels: resolutions, each half of the one before.
    """

    inputs: int
    width: int
    code: int
    flash: int
    levels: int = 5

    def channels(self, level: int) -> int:
        """Channels at a level, 0 the finest."""
        result: int = self.width * min(2**level, MOST)
        return result

    def init(self, rng: Generator) -> Params:
        """Random parameters."""
        encoder: Params = {}
        layer = functools.partial(add_layer, encoder, rng)

        def block(name: str, inputs: int, outputs: int) -> None:
            layer(f"{name}.first", outputs, inputs, 3, 3)
            layer(f"{name}.second", outputs, outputs, 3, 3, gain=0.7)
            layer(f"{name}.mean", outputs, outputs, gain=0.5)

        block("down0", self.inputs, self.channels(0))
        for level in range(1, self.levels):
            block(f"down{level}", self.channels(level - 1), self.channels(level))
        for level in reversed(range(self.levels - 1)):
            block(f"up{level}", self.channels(level + 1) + self.channels(level), self.channels(level))
        layer("code", self.code, self.channels(0), gain=0.3)
        layer("flash", self.flash, self.channels(self.levels - 1) * LOOKED**2, gain=0.1)
        return encoder

    def __call__(self, encoder: Params, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """The code [T, code, H, W] and the flash [T, flash] of what is known of the pixels, [T, inputs, H, W]."""
        x, skips = inputs.contiguous(memory_format=torch.channels_last), []
        for level in range(self.levels):
            x = _block(encoder, f"down{level}", avg_pool2d(x, 2) if level else x)
            skips.append(x)
        flash = dense(encoder, "flash", adaptive_avg_pool2d(x, LOOKED).flatten(1))
        for level in reversed(range(self.levels - 1)):
            x = torch.cat([interpolate(x, scale_factor=2, mode="nearest"), skips[level]], 1)
            x = _block(encoder, f"up{level}", x)
        return conv2d(x, encoder["code.kernel"][..., None, None], encoder["code.shift"]), flash


def _block(encoder: Params, name: str, x: Tensor) -> Tensor:
    """Two convolutions, the second beside a path around it, which adds what the picture's mean says."""
    first = leaky_relu(convolved(encoder, f"{name}.first", x), SLOPE)
    mean = dense(encoder, f"{name}.mean", first.mean((2, 3)))
    return first + leaky_relu(convolved(encoder, f"{name}.second", first) + mean[..., None, None], SLOPE)
