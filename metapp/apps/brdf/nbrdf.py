"""The NBRDF network of Sztrajman et al. 2021: 675 weights a material, and the set encoder that predicts them."""

from __future__ import annotations

import itertools
import math

import torch
from torch import Generator, Tensor

from metapp.apps.brdf.samples import read_set, set_encoder
from metapp.learning.task import Batch, Params

WIDTHS = (6, 21, 21, 3)
ENCODER = 128


def network(theta: Params, inputs: Tensor) -> Tensor:
    """Reflectance before the clamp at 0.

    Args:
        theta: weights w1..w3 [T, out, in] and biases b1..b3 [T, out, 1].
        inputs: half and difference vectors [T, 6, N].

    Returns:
        exp(out) - 1, [T, 3, N], linear RGB in 1/sr, above -1.
    """
    x = inputs
    for layer in (1, 2):
        x = torch.relu(torch.baddbmm(theta[f"b{layer}"], theta[f"w{layer}"], x))
    return torch.expm1(torch.baddbmm(theta["b3"], theta["w3"], x))


def init(rng: Generator, count: int) -> Params:
    """Kaiming-normal weights and zero biases, [count, ...]."""
    theta = {}
    for layer, (inputs, outputs) in enumerate(itertools.pairwise(WIDTHS), 1):
        noise = torch.randn(count, outputs, inputs, generator=rng, device=rng.device)
        theta[f"w{layer}"] = noise * math.sqrt((2 if layer < 3 else 1) / inputs)
        theta[f"b{layer}"] = torch.zeros(count, outputs, 1, device=rng.device)
    return theta


def init_encoder(rng: Generator) -> Params:
    """A set encoder to all 675 weights; before training it predicts a random network."""
    weights = sum(rows * columns for rows, columns in shapes().values())
    encoder = set_encoder(rng, 10, ENCODER, weights)
    start = init(rng, 1)
    encoder["out.b"] = torch.cat([value.flatten() for value in start.values()])
    return encoder


def encode(encoder: Params, condition: Batch) -> Params:
    """Predict all weights from samples."""
    flat = read_set(encoder, torch.cat([condition["where"], condition["target"]], 1).transpose(1, 2))
    theta, at = {}, 0
    for name, (rows, columns) in shapes().items():
        theta[name] = flat[:, at : at + rows * columns].reshape(-1, rows, columns)
        at += rows * columns
    return theta


def shapes() -> dict[str, tuple[int, int]]:
    """The shape of each parameter of one task."""
    result: dict[str, tuple[int, int]] = {}
    for layer, (inputs, outputs) in enumerate(itertools.pairwise(WIDTHS), 1):
        result |= {f"w{layer}": (outputs, inputs), f"b{layer}": (outputs, 1)}
    return result
