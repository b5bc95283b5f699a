"""The NBRDF network of Sztrajman et al. 2021: 675 weights a material, and the set encoder that predicts them."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor
from torch.nn.functional import gelu, layer_norm

from metapp.apps.brdf.brdf_network import BrdfNetwork, PlainLayers, parameter_shapes
from metapp.apps.brdf.energy import conserve_energy, quadrature_places
from metapp.learning.random_tensors import draw_normal, draw_uniform
from metapp.learning.task import Batch, Params

LAYER_WIDTHS = (6, 21, 21, 3)
ENCODER_WIDTH = 128
WEIGHT_KNOTS = 8  # of learned weights of samples, over theta_h


@dataclass(frozen=True)
class Nbrdf(BrdfNetwork):
    """Weights w1..w3 [T, out, in] and biases b1..b3 [T, out, 1], of one size, all a material's own.

    Attributes:
        bound: random weights are uniform within this of 0, as Sztrajman et al. 2021 draw them; 0: Kaiming-normal.
    """

    bound: float = 0.0
    can_conserve = True

    def init(self, rng: Generator, count: int) -> Params:
        """Random weights and zero biases, [count, ...]."""
        theta = {}
        for layer, (inputs, outputs) in enumerate(itertools.pairwise(LAYER_WIDTHS), 1):
            if self.bound:
                weights = (2 * draw_uniform(rng, count, outputs, inputs) - 1) * self.bound
            else:
                weights = draw_normal(rng, count, outputs, inputs) * math.sqrt((2 if layer < 3 else 1) / inputs)
            theta[f"w{layer}"] = weights
            theta[f"b{layer}"] = torch.zeros(count, outputs, 1, device=rng.device)
        return theta

    def init_encoder(self, rng: Generator) -> Params:
        """A set encoder to all 675 weights; before training it predicts a random network."""
        encoder = init_set_encoder(rng, 10, ENCODER_WIDTH, sum(map(math.prod, parameter_shapes(self).values())))
        network = self.init(rng, 1)
        encoder["out.b"] = torch.cat([value.flatten() for value in network.values()])
        return encoder

    def encode(self, encoder: Params, condition: Batch) -> Params:
        flat = read_set(encoder, torch.cat([condition["where"], condition["target"]], 1).transpose(1, 2))
        parts = flat.split([math.prod(shape) for shape in parameter_shapes(self).values()], 1)
        return {
            name: part.reshape(-1, *shape)
            for part, (name, shape) in zip(parts, parameter_shapes(self).items(), strict=True)
        }

    def reflectance(self, theta: Params, where: Tensor) -> Tensor:
        return torch.expm1(torch.baddbmm(theta["b3"], theta["w3"], hidden_layer(theta, where)))

    def conserved(self, theta: Params) -> Params:
        """With a last layer that reflects no more than all."""
        x = hidden_layer(theta, quadrature_places(theta["w3"]))
        features = torch.cat([x, torch.ones_like(x[:, :1])], 1)
        layers = torch.cat([theta["w3"], theta["b3"]], 2)
        last = torch.stack([conserve_energy(*each) for each in zip(features, layers, strict=True)])
        return theta | {"w3": last[..., :-1].contiguous(), "b3": last[..., -1:].contiguous()}

    def folded(self, theta: Params) -> PlainLayers:
        theta = {key: value.detach().double() for key, value in theta.items()}
        return PlainLayers([(theta[f"w{layer}"], theta[f"b{layer}"].flatten()) for layer in (1, 2, 3)], "nbrdf")


NBRDF_NETWORK = Nbrdf()


def hidden_layer(theta: Params, where: Tensor) -> Tensor:
    """The last hidden layer, [T, 21, N] of places [T, 7, N]."""
    x = where[:, :6]
    for layer in (1, 2):
        x = torch.relu(torch.baddbmm(theta[f"b{layer}"], theta[f"w{layer}"], x))
    return x


def sample_weights(where: Tensor, learned: Params) -> Tensor:
    """Learned weights of samples, [T, N], between knots over theta_h."""
    position = torch.arccos(where[:, 2].clamp(-1, 1)) * ((WEIGHT_KNOTS - 1) / (math.pi / 2))
    knots = torch.arange(WEIGHT_KNOTS, device=where.device, dtype=where.dtype)
    hat = (1 - (position[:, None] - knots[:, None]).abs()).clamp_min(0)
    return torch.exp((learned["weights"][:, None] @ hat)[:, 0])


# The set encoder: a network on each sample, the mean and maximum over samples, a network on these


def init_set_encoder(rng: Generator, inputs: int, width: int, outputs: int) -> Params:
    """Random parameters: samples of `inputs` numbers to `outputs` numbers."""
    sizes = {"in": (inputs, width), "mid": (width, width), "set": (2 * width, 2 * width)}
    sizes |= {"deep": (2 * width, 2 * width), "out": (2 * width, outputs)}
    encoder = {}
    for name, (rows, columns) in sizes.items():
        gain = 0.1 if name == "out" else math.sqrt(2)
        noise = draw_normal(rng, rows, columns)
        encoder[f"{name}.w"] = noise * gain / math.sqrt(rows)
        encoder[f"{name}.b"] = torch.zeros(columns, device=rng.device)
    return encoder


def read_set(encoder: Params, samples: Tensor) -> Tensor:
    """Read samples [T, N, inputs] by a set encoder: [T, outputs]."""

    def dense(name: str, x: Tensor) -> Tensor:
        return x @ encoder[f"{name}.w"] + encoder[f"{name}.b"]

    x = gelu(dense("mid", gelu(dense("in", samples))))
    x = torch.cat([x.mean(1), x.amax(1)], 1)
    x = layer_norm(x, x.shape[-1:])
    x = gelu(dense("set", x))
    x = x + gelu(dense("deep", layer_norm(x, x.shape[-1:])))
    return dense("out", x)
