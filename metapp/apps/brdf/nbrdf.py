"""The NBRDF network of Sztrajman et al. 2021: 675 weights a material, and the set encoder that predicts them."""

from __future__ import annotations

import itertools
import math

import torch
from torch import Generator, Tensor
from torch.nn.functional import gelu, layer_norm

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
    network = init(rng, 1)
    encoder["out.b"] = torch.cat([value.flatten() for value in network.values()])
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


# The set encoder: a network on each sample, the mean and maximum over samples, a network on these


def set_encoder(rng: Generator, inputs: int, width: int, outputs: int) -> Params:
    """Random parameters: samples of `inputs` numbers to `outputs` numbers."""
    sizes = {"in": (inputs, width), "mid": (width, width), "set": (2 * width, 2 * width)}
    sizes |= {"deep": (2 * width, 2 * width), "out": (2 * width, outputs)}
    encoder = {}
    for name, (rows, columns) in sizes.items():
        gain = 0.1 if name == "out" else math.sqrt(2)
        noise = torch.randn(rows, columns, generator=rng, device=rng.device)
        encoder[f"{name}.w"] = noise * gain / math.sqrt(rows)
        encoder[f"{name}.b"] = torch.zeros(columns, device=rng.device)
    return encoder


def read_set(encoder: Params, samples: Tensor) -> Tensor:
    """What an encoder says of samples [T, N, inputs]: [T, outputs]."""

    def dense(name: str, x: Tensor) -> Tensor:
        return x @ encoder[f"{name}.w"] + encoder[f"{name}.b"]

    x = gelu(dense("mid", gelu(dense("in", samples))))
    x = torch.cat([x.mean(1), x.amax(1)], 1)
    x = layer_norm(x, x.shape[-1:])
    x = gelu(dense("set", x))
    x = x + gelu(dense("deep", layer_norm(x, x.shape[-1:])))
    return dense("out", x)
