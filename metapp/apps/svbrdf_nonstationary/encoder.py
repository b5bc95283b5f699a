"""General's encoder: a U-Net from the flash photograph of a material to the code of its field, and to its flash."""

from __future__ import annotations

import functools
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool2d, conv2d, interpolate, leaky_relu

from metapp.apps.svbrdf_nonstationary.maps import FLASH, INPUTS, inputs_of
from metapp.learning.task import Params
from metapp.networks.layers import add_layer, convolved, dense

SLOPE = 0.1
BASE = 64  # texels a side of the level that all others are counted from
LEVELS = 5  # resolutions from BASE down, each half of the one before
FLASH_CELLS = 4  # cells a side of the coarsest level that the flash is looked for in
WIDEST_TIMES = 8  # times the finest level's channels, at the coarsest


class Encoder(NamedTuple):
    """A U-Net whose levels all know the picture's mean (Ronneberger et al. 2015; Deschaintre et al. 2018).

    It reads a photograph at BASE texels, and if that is larger, its finer levels add to the output of the
    coarser ones. So its weights serve at every resolution up to BASE * 2^len(finer).

    Attributes:
        width: channels of the level of BASE texels; each level down has twice as many, up to WIDEST_TIMES times.
        code: length of the code in a pixel.
        finer: channels of the levels above, the coarsest first.
    """

    width: int
    code: int
    finer: tuple[int, ...] = ()

    def channels(self, level: int) -> int:
        """Channels at a level, 0 that of BASE texels."""
        result: int = self.width * min(2**level, WIDEST_TIMES)
        return result

    def init(self, rng: Generator) -> Params:
        """Random parameters; finer levels add nothing at first."""
        encoder: Params = {}
        layer, block = (functools.partial(add, encoder, rng) for add in (add_layer, add_block))
        block("down0", INPUTS, self.channels(0))
        for level in range(1, LEVELS):
            block(f"down{level}", self.channels(level - 1), self.channels(level))
        for level in reversed(range(LEVELS - 1)):
            block(f"up{level}", self.channels(level + 1) + self.channels(level), self.channels(level))
        layer("code", self.code, self.channels(0), gain=0.3)
        layer("flash", FLASH, self.channels(LEVELS - 1) * FLASH_CELLS**2, gain=0.1)
        below = self.channels(0)
        for level, (width, above) in enumerate(zip(self.finer, (*self.finer, 0)[1:], strict=True)):
            block(f"finer{level}.down", INPUTS + above, width)
            block(f"finer{level}.up", below + width, width)
            layer(f"finer{level}.code", self.code, width, gain=0.0)
            below = width
        if self.finer:
            layer("finer0.known", INPUTS, self.finer[0], gain=0.0)
        return encoder

    def __call__(self, encoder: Params, photos: Tensor) -> Params:
        """Read linear photographs [T, 3, H, H]: `z`, the code [T, code, H, H], and `flash` [T, FLASH].

        If there are finer levels, H is at most BASE, or BASE times a power of two.
        """
        added, finer = self._finer_down(encoder, photos)
        base = adaptive_avg_pool2d(photos, min(BASE, photos.shape[-1])) if finer else photos
        x, skips = inputs_of(base).contiguous(memory_format=torch.channels_last), []
        x = x if added is None else x + added
        for level in range(LEVELS):
            x = block(encoder, f"down{level}", avg_pool2d(x, 2) if level else x)
            skips.append(x)
        flash = dense(encoder, "flash", adaptive_avg_pool2d(x, FLASH_CELLS).flatten(1))
        for level in reversed(range(LEVELS - 1)):
            x = block(encoder, f"up{level}", torch.cat([twice(x), skips[level]], 1))
        code = pointwise(encoder, "code", x)
        for level, skip in enumerate(finer):
            x = block(encoder, f"finer{level}.up", torch.cat([twice(x), skip], 1))
            larger = interpolate(code, scale_factor=2, mode="bilinear")
            code = larger + pointwise(encoder, f"finer{level}.code", x)
        return {"z": code, "flash": flash}

    def _finer_down(self, encoder: Params, photos: Tensor) -> tuple[Tensor | None, list[Tensor]]:
        """The addition of the levels above BASE to that of BASE, and their features, the coarsest first."""
        count = min(len(self.finer), max(0, (photos.shape[-1] // BASE).bit_length() - 1))
        x, features = None, []
        for level in reversed(range(count)):
            size = BASE << (level + 1)
            inputs = inputs_of(adaptive_avg_pool2d(photos, size)).contiguous(memory_format=torch.channels_last)
            if level + 1 < len(self.finer):  # none above: as if these had nothing to tell
                above = inputs.new_zeros(len(inputs), self.finer[level + 1], size, size)
                inputs = torch.cat([inputs, above if x is None else avg_pool2d(x, 2)], 1)
            x = block(encoder, f"finer{level}.down", inputs)
            features.append(x)
        added = None if x is None else pointwise(encoder, "finer0.known", avg_pool2d(x, 2))
        return added, features[::-1]


def twice(x: Tensor) -> Tensor:
    """Maps twice as high and wide, each texel four times."""
    return interpolate(x, scale_factor=2, mode="nearest")


def pointwise(encoder: Params, name: str, x: Tensor) -> Tensor:
    """A layer of `add_layer` that reads each pixel of maps [T, inputs, H, W] by itself."""
    return conv2d(x, encoder[f"{name}.kernel"][..., None, None], encoder[f"{name}.shift"])


def add_block(encoder: Params, rng: Generator, name: str, inputs: int, outputs: int) -> None:
    """Add the random parameters of a `block` from `inputs` to `outputs` channels."""
    add_layer(encoder, rng, f"{name}.first", outputs, inputs, 3, 3)
    add_layer(encoder, rng, f"{name}.second", outputs, outputs, 3, 3, gain=0.7)
    add_layer(encoder, rng, f"{name}.mean", outputs, outputs, gain=0.5)


def block(encoder: Params, name: str, x: Tensor) -> Tensor:
    """Two convolutions, the second beside a path around it, which adds a term of the picture's mean."""
    first = leaky_relu(convolved(encoder, f"{name}.first", x), SLOPE)
    mean = dense(encoder, f"{name}.mean", first.mean((2, 3)))
    return first + leaky_relu(convolved(encoder, f"{name}.second", first) + mean[..., None, None], SLOPE)
