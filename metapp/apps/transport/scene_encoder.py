"""General's encoder: a small picture of a scene to the code of its flow and to the light's places on the film."""

from __future__ import annotations

import functools

import torch
from torch import Generator, Tensor
from torch.nn.functional import conv2d, leaky_relu

from metapp.appearance.latlong import luminance
from metapp.apps.transport.flow import Flow
from metapp.learning.task import Params
from metapp.networks.layers import add_layer, apply_convolution, apply_dense

LEAKY_SLOPE = 0.1
LIGHT_FLOOR = 0.01  # of a picture of mean luminance 1: its log is flat below
ENCODER_CHANNELS, ATTENTION_HEADS, RESIDUAL_BLOCKS = (
    48,
    8,
    3,
)  # of the convolutions; attention maps; convolutions after these


def init_reader(rng: Generator, code: int) -> Params:
    """Random parameters; at first the flow's directions are almost uniform and its film is the picture."""
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
    """The own parameters of T flows, by convolutions that also read the whole picture, pooled by HEADS attention maps.

    Args:
        reader: parameters, as of `init_reader`.
        images: linear RGB of any scale, [T, 3, 2 rows, 2 columns] of the flow's grid.
        flow: of the codes.

    Returns:
        `z`, `film.x` and `film.y`, each [T, ...].
    """
    light = luminance(images)
    logs = (light / light.mean((1, 2), keepdim=True).clamp_min(1e-12) + LIGHT_FLOOR).log()
    colours = images / (images.sum(1, keepdim=True) + 1e-6) - 1 / 3
    x = torch.cat([logs[:, None], colours[:, ::2], cell_coordinates(images)], 1)
    x = leaky_relu(conv2d(x, reader["in.kernel"], reader["in.shift"], stride=2, padding=1), LEAKY_SLOPE)
    grid = cell_coordinates(x)
    features = leaky_relu(apply_convolution(reader, "look", x), LEAKY_SLOPE)
    weights = apply_convolution(reader, "heads", features).flatten(2).softmax(2)
    pooled = weights @ torch.cat([features, grid], 1).flatten(2).mT
    whole = apply_dense(reader, "whole", pooled.flatten(1))
    x = features + whole[..., None, None]
    for i in range(RESIDUAL_BLOCKS):
        x = x + leaky_relu(apply_convolution(reader, f"block{i}", torch.cat([x, grid], 1)), LEAKY_SLOPE)
    film = _film(logs, apply_convolution(reader, "film", x))
    own = {"z": apply_convolution(reader, "code", x) / flow.gain}
    return own | {key: value / flow.film_gain for key, value in film.items()}


def _film(logs: Tensor, corrections: Tensor) -> Params:
    """The film's splines: evenly wide bins with values of the picture, [T, rows, columns], and corrections."""
    fine = corrections.repeat_interleave(2, 2).repeat_interleave(2, 3)
    of_picture = torch.stack([torch.zeros_like(logs), logs, torch.zeros_like(logs)], 1)
    widths, masses, bends = fine[:, 3:].mean(2).unbind(1)
    shares = logs.exp().sum(1).log() + masses
    return {"film.x": torch.cat([widths, shares, bends, bends[:, -1:]], 1), "film.y": of_picture + fine[:, :3]}


def cell_coordinates(like: Tensor) -> Tensor:
    """The coordinates in [-1, 1] of the cells of a grid [T, C, rows, columns]: x and y, [T, 2, rows, columns]."""
    rows, columns = like.shape[-2:]
    y, x = (((torch.arange(n, device=like.device) + 0.5) * (2 / n) - 1).to(like) for n in (rows, columns))
    grid = torch.stack([x.expand(rows, columns), y[:, None].expand(rows, columns)])
    return grid.expand(len(like), -1, -1, -1)
