"""General's encoder of light transport: from a small picture of a scene to the code of its flow and the film's splines.

The picture shows where light arrives on the film; the directions from which it comes have to be guessed.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import torch
from torch import Generator, Tensor
from torch.nn.functional import conv2d, leaky_relu
from typing_extensions import override

from metapp.appearance.latlong import luminance
from metapp.apps.transport.flow import Flow
from metapp.apps.transport.path_fits import FlowDensity, SeenPaths
from metapp.learning.components import Encoder
from metapp.learning.task import Batch, Params
from metapp.networks.coded import add_decoder, join_encoder, select_reader
from metapp.networks.layers import add_layer, apply_convolution, apply_dense

ENCODER_LEAKY_SLOPE = 0.1  # slope below 0 of the leaky ReLUs of the encoder
LIGHT_FLOOR = 0.01  # luminance in a picture of mean luminance 1, below which its log is flat
# channels of convolutions, maps by which the whole picture is pooled, and convolutions after that
ENCODER_CHANNELS, ATTENTION_HEADS, RESIDUAL_BLOCKS = 48, 8, 3


@dataclass(frozen=True)
class ScenePictureEncoder(Encoder[SeenPaths]):
    """The encoder of pictures of scenes; all flows share the parameters that no picture tells."""

    samples = 0  # it reads no paths

    @override
    def init(self, rng: Generator, decoder: FlowDensity) -> Params:
        """Draw the reader of pictures, and the parameters of the flow that all tasks share."""
        network = decoder.network
        return join_encoder(init_reader(rng, network.code), network.init(rng, 1), ("z", "film.x", "film.y"))

    @override
    def select_input(self, seen: SeenPaths) -> Batch:
        return {"image": seen.image}

    @override
    def __call__(self, encoder: Params, encoder_input: Batch, decoder: FlowDensity) -> Params:
        read = read_scene_pictures(select_reader(encoder), encoder_input["image"], decoder.network)
        return add_decoder(read, encoder)


def init_reader(rng: Generator, code: int) -> Params:
    """Draw random parameters of the reader of pictures.

    At first a flow's film is the picture, and its directions are almost uniform.

    Args:
        rng: the source of all draws.
        code: length of the code.
    """
    reader: Params = {}
    layer = functools.partial(add_layer, reader, rng)

    layer("in", ENCODER_CHANNELS, 5, 4, 4)
    layer("look", ENCODER_CHANNELS, ENCODER_CHANNELS, 3, 3)
    layer("heads", ATTENTION_HEADS, ENCODER_CHANNELS, 1, 1, gain=1.0)
    layer("whole", ENCODER_CHANNELS, ATTENTION_HEADS * (ENCODER_CHANNELS + 2), gain=1.0)
    for i in range(RESIDUAL_BLOCKS):
        layer(f"block{i}", ENCODER_CHANNELS, ENCODER_CHANNELS + 2, 3, 3, gain=1.0)
    layer("code", code, ENCODER_CHANNELS, 1, 1, gain=1.0)
    layer("film", 6, ENCODER_CHANNELS, 1, 1, gain=0.0)
    return reader


def read_scene_pictures(reader: Params, images: Tensor, flow: Flow) -> Params:
    """Predict the parameters that each flow has for itself from pictures of scenes.

    Convolutions read the surroundings of each cell of the flow's grid. A summary of the whole picture, which
    ATTENTION_HEADS attention maps pool, is added to each cell.

    Args:
        reader: parameters of :func:`init_reader`.
        images: linear RGB of any scale, [T, 3, 2 rows, 2 columns], where rows and columns are those of the flow's grid.
        flow: the network, for its gains.

    Returns:
        `z`, `film.x` and `film.y`, each [T, ...].
    """
    light = luminance(images)
    logs = (light / light.mean((1, 2), keepdim=True).clamp_min(1e-12) + LIGHT_FLOOR).log()
    colours = images / (images.sum(1, keepdim=True) + 1e-6) - 1 / 3
    features = torch.cat([logs[:, None], colours[:, ::2], cell_coordinates(images)], 1)
    features = leaky_relu(
        conv2d(features, reader["in.kernel"], reader["in.shift"], stride=2, padding=1), ENCODER_LEAKY_SLOPE
    )
    coordinates = cell_coordinates(features)
    cell_features = leaky_relu(apply_convolution(reader, "look", features), ENCODER_LEAKY_SLOPE)
    attention = apply_convolution(reader, "heads", cell_features).flatten(2).softmax(2)
    pooled = attention @ torch.cat([cell_features, coordinates], 1).flatten(2).mT
    whole = apply_dense(reader, "whole", pooled.flatten(1))
    features = cell_features + whole[..., None, None]
    for i in range(RESIDUAL_BLOCKS):
        features = features + leaky_relu(
            apply_convolution(reader, f"block{i}", torch.cat([features, coordinates], 1)), ENCODER_LEAKY_SLOPE
        )
    film = _make_film_splines(logs, apply_convolution(reader, "film", features))
    parameters = {"z": apply_convolution(reader, "code", features) / flow.gain}
    return parameters | {key: value / flow.film_gain for key, value in film.items()}


def _make_film_splines(logs: Tensor, corrections: Tensor) -> Params:
    """Return `film.x` and `film.y`, the splines over the film: bins of even width with the picture's light, corrected.

    Args:
        logs: log luminance of the picture, [T, rows, columns].
        corrections: numbers that the reader adds, [T, 6, rows / 2, columns / 2].
    """
    finer_corrections = corrections.repeat_interleave(2, 2).repeat_interleave(2, 3)
    picture_numbers = torch.stack([torch.zeros_like(logs), logs, torch.zeros_like(logs)], 1)
    widths, masses, bends = finer_corrections[:, 3:].mean(2).unbind(1)
    log_masses = logs.exp().sum(1).log() + masses
    return {
        "film.x": torch.cat([widths, log_masses, bends, bends[:, -1:]], 1),
        "film.y": picture_numbers + finer_corrections[:, :3],
    }


def cell_coordinates(like: Tensor) -> Tensor:
    """Return the coordinates x and y in [-1, 1] of the cells of a grid, [T, 2, rows, columns].

    Args:
        like: a tensor [T, C, rows, columns] on the grid.
    """
    rows, columns = like.shape[-2:]
    y, x = (((torch.arange(n, device=like.device) + 0.5) * (2 / n) - 1).to(like) for n in (rows, columns))
    grid = torch.stack([x.expand(rows, columns), y[:, None].expand(rows, columns)])
    return grid.expand(len(like), -1, -1, -1)
