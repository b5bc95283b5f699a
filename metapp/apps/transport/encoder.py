"""General's encoder: a small picture of a scene to the code of its flow and to where on the film its light is."""

from __future__ import annotations

import functools
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import conv2d, leaky_relu

from metapp.appearance.latlong import luminance
from metapp.apps.transport.flow import Flow
from metapp.learning.task import Params
from metapp.networks.layers import add_layer, convolved, dense

SLOPE = 0.1
LIGHT_FLOOR = 0.01  # of a picture of mean luminance 1: its log is flat below
BLOCKS = 3


class Encoder(NamedTuple):
    """Convolutions on the film that also read the whole picture, pooled by a few learned attention maps.

    Attributes:
        flow: what it is for; its grid has half as many rows and columns as the picture.
        channels: of the convolutions.
        heads: attention maps.
    """

    flow: Flow
    channels: int = 48
    heads: int = 8

    def init(self, rng: Generator) -> Params:
        """Random parameters; at first the flow's directions are almost uniform and its film is the picture."""
        encoder: Params = {}
        layer = functools.partial(add_layer, encoder, rng)

        layer("in", self.channels, 5, 4, 4)
        layer("look", self.channels, self.channels, 3, 3)
        layer("heads", self.heads, self.channels, 1, 1, gain=1.0)
        layer("whole", self.channels, self.heads * (self.channels + 2), gain=1.0)
        for i in range(BLOCKS):
            layer(f"block{i}", self.channels, self.channels + 2, 3, 3, gain=1.0)
        layer("code", self.flow.code, self.channels, 1, 1, gain=1.0)
        layer("film", 6, self.channels, 1, 1, gain=0.0)
        return encoder

    def __call__(self, encoder: Params, images: Tensor) -> Params:
        """The own parameters of T flows.

        Args:
            encoder: parameters, as of `init`.
            images: linear RGB of any scale, [T, 3, 2 rows, 2 columns] of the flow's grid.

        Returns:
            `z`, `film.x` and `film.y`, each [T, ...].
        """
        light = luminance(images)
        logs = (light / light.mean((1, 2), keepdim=True).clamp_min(1e-12) + LIGHT_FLOOR).log()
        colours = images / (images.sum(1, keepdim=True) + 1e-6) - 1 / 3
        x = torch.cat([logs[:, None], colours[:, ::2], places(images)], 1)
        x = leaky_relu(conv2d(x, encoder["in.kernel"], encoder["in.shift"], stride=2, padding=1), SLOPE)
        grid = places(x)
        features = leaky_relu(convolved(encoder, "look", x), SLOPE)
        weights = convolved(encoder, "heads", features).flatten(2).softmax(2)
        pooled = weights @ torch.cat([features, grid], 1).flatten(2).mT
        whole = dense(encoder, "whole", pooled.flatten(1))
        x = features + whole[..., None, None]
        for i in range(BLOCKS):
            x = x + leaky_relu(convolved(encoder, f"block{i}", torch.cat([x, grid], 1)), SLOPE)
        code = convolved(encoder, "code", x)
        return {"z": code / self.flow.gain} | self._film(logs, convolved(encoder, "film", x))

    def _film(self, logs: Tensor, corrections: Tensor) -> Params:
        """The film's splines: evenly wide bins that hold what the picture says, [T, rows, columns], and corrections."""
        fine = corrections.repeat_interleave(2, 2).repeat_interleave(2, 3)
        of_picture = torch.stack([torch.zeros_like(logs), logs, torch.zeros_like(logs)], 1)
        widths, masses, bends = fine[:, 3:].mean(2).unbind(1)
        shares = logs.exp().sum(1).log() + masses
        numbers = {"film.x": torch.cat([widths, shares, bends, bends[:, -1:]], 1), "film.y": of_picture + fine[:, :3]}
        return {key: value / self.flow.film_gain for key, value in numbers.items()}


def places(like: Tensor) -> Tensor:
    """The coordinates in [-1, 1] of the cells of a grid [T, C, rows, columns]: x and y, [T, 2, rows, columns]."""
    rows, columns = like.shape[-2:]
    y, x = (((torch.arange(n, device=like.device) + 0.5) * (2 / n) - 1).to(like) for n in (rows, columns))
    grid = torch.stack([x.expand(rows, columns), y[:, None].expand(rows, columns)])
    return grid.expand(len(like), -1, -1, -1)
