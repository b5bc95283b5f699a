"""A set encoder: a network on each sample, the mean and maximum over samples, a network on these."""

from __future__ import annotations

import math

import torch
from torch import Generator, Tensor
from torch.nn.functional import gelu, layer_norm

from metapp.learning.task import Params


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
