"""The decoder of textures, and the encoder of textures of pieces of the photograph, whose light a network corrects.

Fits of pieces begin with the error of the best of several quilts, and their steps lower it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.apps.exemplar.exemplar_codec import ExemplarDecoder, SummaryEncoder, move_tiles
from metapp.apps.exemplar.quilts import QUILT_NAMES, select_quilts
from metapp.learning.task import Batch, Params


class TextureAnswer(NamedTuple):
    """Textures, and how much quilts are changed in them.

    Attributes:
        prediction: the textures, sRGB in [0, 1], [T, B, 3, H, W].
        quilt_change: the mean squared change of each quilt, [T]; None for textures from noise.
    """

    prediction: Tensor
    quilt_change: Tensor | None = None


@dataclass(frozen=True)
class TextureDecoder(ExemplarDecoder[TextureAnswer]):
    """Textures that tile: sigmoids of the network's output or, with quilts, corrected quilts, moved as noise says."""

    @property
    @override
    def is_periodic(self) -> bool:
        return self.reads_quilts and bool(self.network.periodic)

    @override
    def generate(self, theta: Params, noise: Tensor, octave: int = 0) -> TextureAnswer:
        if not self.reads_quilts:
            return TextureAnswer(torch.sigmoid(self.network(theta, noise)))
        tiles = self.network(theta, theta["quilt"])
        change = (tiles - theta["quilt"].clamp(0, 1)).square().mean((-1, -2, -3))
        return TextureAnswer(move_tiles(tiles, noise), change)


@dataclass(frozen=True)
class LightEncoder(SummaryEncoder):
    """The network's own encoder, of quilts and of `moments` [T, 6], the channels' means and deviations of exemplars."""

    input_names = (*QUILT_NAMES, "moments")

    @override
    def init(self, rng: Generator, decoder: Any) -> Params:
        encoder: Params = decoder.network.init_encoder(rng)
        return encoder

    @override
    def __call__(self, encoder: Params, encoder_input: Batch, decoder: Any) -> Params:
        theta: Params = decoder.network.encode(encoder, encoder_input["quilt"], encoder_input["moments"])
        return theta | select_quilts(encoder_input)
