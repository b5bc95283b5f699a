"""General's encoder: a U-Net from the flash photograph of a material to the code of its field, and to its flash.

Its layers and blocks also serve the encoders of the recipes `pretrained` and `several`.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool2d, conv2d, interpolate, leaky_relu
from typing_extensions import override

from metapp.apps.svbrdf_nonstationary.flashes import FLASH_NUMBERS
from metapp.apps.svbrdf_nonstationary.maps import PIXEL_INPUTS, pixel_inputs
from metapp.learning.task import Params
from metapp.networks.coded import CodeEncoder
from metapp.networks.field import LocalField
from metapp.networks.layers import add_layer, apply_convolution, apply_dense

ENCODER_LEAKY_SLOPE = 0.1  # slope below 0 of the leaky ReLUs of the encoder
BASE_TEXELS = 64  # a side of the level that all others are counted from
LEVEL_COUNT = 5  # resolutions from BASE_TEXELS down, each half of the one before
FLASH_CELLS = 4  # cells a side of the coarsest level that the flash is looked for in
WIDEST_TIMES = 8  # the most channels of a level, over the channels of the level of BASE_TEXELS


class PhotoUNet(NamedTuple):
    """A U-Net whose levels all know the picture's mean (Ronneberger et al. 2015; Deschaintre et al. 2018).

    With finer levels it reads a photograph at BASE_TEXELS, and each finer level adds to the code, so that its weights
    serve at every resolution up to BASE_TEXELS * 2^len(finer). Without them it reads a photograph at its own size.

    Attributes:
        width: the number of channels of the level of BASE_TEXELS; each level down has twice as many, up to WIDEST_TIMES
            times as many.
        code: the length of the code in a pixel.
        finer: the numbers of channels of the levels above, the coarsest first.
    """

    width: int
    code: int
    finer: tuple[int, ...] = ()

    def level_channels(self, level: int) -> int:
        """Return the number of channels of a level; level 0 is the finest of the coarse ones."""
        result: int = self.width * min(2**level, WIDEST_TIMES)
        return result

    def init(self, rng: Generator) -> Params:
        """Draw random parameters; finer levels add nothing at first."""
        encoder: Params = {}
        add_random_layer, add_random_block = (functools.partial(add, encoder, rng) for add in (add_layer, add_block))
        add_random_block("down0", PIXEL_INPUTS, self.level_channels(0))
        for level in range(1, LEVEL_COUNT):
            add_random_block(f"down{level}", self.level_channels(level - 1), self.level_channels(level))
        for level in reversed(range(LEVEL_COUNT - 1)):
            add_random_block(
                f"up{level}", self.level_channels(level + 1) + self.level_channels(level), self.level_channels(level)
            )
        add_random_layer("code", self.code, self.level_channels(0), gain=0.3)
        add_random_layer("flash", FLASH_NUMBERS, self.level_channels(LEVEL_COUNT - 1) * FLASH_CELLS**2, gain=0.1)
        below = self.level_channels(0)
        for level, (width, width_above) in enumerate(zip(self.finer, (*self.finer, 0)[1:], strict=True)):
            add_random_block(f"finer{level}.down", PIXEL_INPUTS + width_above, width)
            add_random_block(f"finer{level}.up", below + width, width)
            add_random_layer(f"finer{level}.code", self.code, width, gain=0.0)
            below = width
        if self.finer:
            add_random_layer("finer0.known", PIXEL_INPUTS, self.finer[0], gain=0.0)
        return encoder

    def __call__(self, encoder: Params, photos: Tensor) -> Params:
        """Read linear photographs [T, 3, H, H].

        If there are finer levels, H is at most BASE_TEXELS, or BASE_TEXELS times a power of two.

        Returns:
            `z`, the code [T, code, H, H], and `flash`, the raw parameters of the flash, [T, FLASH_NUMBERS].
        """
        finer_output, finer_features = self._apply_finer(encoder, photos)
        base_photos = adaptive_avg_pool2d(photos, min(BASE_TEXELS, photos.shape[-1])) if finer_features else photos
        x, skips = pixel_inputs(base_photos).contiguous(memory_format=torch.channels_last), []
        x = x if finer_output is None else x + finer_output
        for level in range(LEVEL_COUNT):
            x = apply_block(encoder, f"down{level}", avg_pool2d(x, 2) if level else x)
            skips.append(x)
        flash = apply_dense(encoder, "flash", adaptive_avg_pool2d(x, FLASH_CELLS).flatten(1))
        for level in reversed(range(LEVEL_COUNT - 1)):
            x = apply_block(encoder, f"up{level}", torch.cat([upsample(x), skips[level]], 1))
        code = apply_pointwise(encoder, "code", x)
        for level, features in enumerate(finer_features):
            x = apply_block(encoder, f"finer{level}.up", torch.cat([upsample(x), features], 1))
            enlarged = interpolate(code, scale_factor=2, mode="bilinear")
            code = enlarged + apply_pointwise(encoder, f"finer{level}.code", x)
        return {"z": code, "flash": flash}

    def _apply_finer(self, encoder: Params, photos: Tensor) -> tuple[Tensor | None, list[Tensor]]:
        """Return what the levels above BASE_TEXELS add to that one, and their features, the coarsest first."""
        count = min(len(self.finer), max(0, (photos.shape[-1] // BASE_TEXELS).bit_length() - 1))
        x, features = None, []
        for level in reversed(range(count)):
            size = BASE_TEXELS << (level + 1)
            inputs = pixel_inputs(adaptive_avg_pool2d(photos, size)).contiguous(memory_format=torch.channels_last)
            if level + 1 < len(self.finer):  # a level that is missing above counts as zeros
                no_features = inputs.new_zeros(len(inputs), self.finer[level + 1], size, size)
                inputs = torch.cat([inputs, no_features if x is None else avg_pool2d(x, 2)], 1)
            x = apply_block(encoder, f"finer{level}.down", inputs)
            features.append(x)
        output = None if x is None else apply_pointwise(encoder, "finer0.known", avg_pool2d(x, 2))
        return output, features[::-1]


@dataclass(frozen=True)
class PhotoEncoder(CodeEncoder):
    """The encoder of flash photographs, a :class:`PhotoUNet`.

    Attributes:
        width: the number of channels of the level of BASE_TEXELS.
        size: the side of the photograph that the encoder reads; 0 for the side of the decoder's maps.
        finer: the numbers of channels of the levels above BASE_TEXELS, the coarsest first.
    """

    width: int = 16
    size: int = 0
    finer: tuple[int, ...] = ()

    @override
    def init_reader(self, rng: Generator, network: LocalField) -> Params:
        return PhotoUNet(self.width, network.code, self.finer).init(rng)

    @override
    def read(self, reader: Params, photos: Tensor, network: LocalField) -> Params:
        photos = adaptive_avg_pool2d(photos, self.size or photos.shape[-1])
        parameters = PhotoUNet(self.width, network.code, self.finer)(reader, photos)
        return parameters | {key: parameters[key] / network.gain for key in ("z", "flash")}


def upsample(x: Tensor) -> Tensor:
    """Repeat each texel of pictures [T, C, H, W] twice in both directions."""
    return interpolate(x, scale_factor=2, mode="nearest")


def apply_pointwise(encoder: Params, name: str, x: Tensor) -> Tensor:
    """Apply a layer of `add_layer` to each pixel of pictures [T, inputs, H, W] by itself: [T, outputs, H, W]."""
    return conv2d(x, encoder[f"{name}.kernel"][..., None, None], encoder[f"{name}.shift"])


def add_block(encoder: Params, rng: Generator, name: str, inputs: int, outputs: int) -> None:
    """Add the random parameters of :func:`apply_block` from `inputs` to `outputs` channels."""
    add_layer(encoder, rng, f"{name}.first", outputs, inputs, 3, 3)
    add_layer(encoder, rng, f"{name}.second", outputs, outputs, 3, 3, gain=0.7)
    add_layer(encoder, rng, f"{name}.mean", outputs, outputs, gain=0.5)


def apply_block(encoder: Params, name: str, x: Tensor) -> Tensor:
    """Apply two convolutions; the second is beside a path around it and knows the mean of the picture."""
    first = leaky_relu(apply_convolution(encoder, f"{name}.first", x), ENCODER_LEAKY_SLOPE)
    mean = apply_dense(encoder, f"{name}.mean", first.mean((2, 3)))
    return first + leaky_relu(
        apply_convolution(encoder, f"{name}.second", first) + mean[..., None, None], ENCODER_LEAKY_SLOPE
    )
