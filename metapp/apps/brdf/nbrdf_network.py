"""The NBRDF network of Sztrajman et al. 2021: 675 weights, all of them a material's own, and General's set encoder.

The set encoder reads samples in any order and number. Its two functions also serve the encoder of the feature network,
:mod:`metapp.apps.brdf.feature_network`.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor
from torch.nn.functional import gelu, layer_norm
from typing_extensions import override

from metapp.apps.brdf.brdf_network import BrdfNetwork, PlainLayers, parameter_shapes
from metapp.apps.brdf.energy import conserve_energy, quadrature_places
from metapp.learning.random_tensors import draw_normal, draw_uniform
from metapp.learning.task import Batch, Params

LAYER_WIDTHS = (6, 21, 21, 3)  # half and difference vector, units of two hidden layers, channels
ENCODER_WIDTH = 128  # units of the set encoder's layers that read single samples
WEIGHT_KNOTS = 8  # knots over theta_h, evenly spaced from 0 to pi/2, of learned weights of samples


@dataclass(frozen=True)
class Nbrdf(BrdfNetwork):
    """The NBRDF network: weights w1 to w3 [T, out, in] and biases b1 to b3 [T, out, 1], all of them a material's own.

    Attributes:
        bound: random weights are uniform in [-bound, bound], as in Sztrajman et al. 2021; 0: Kaiming-normal.
    """

    bound: float = 0.0
    can_conserve_energy = True

    @override
    def init(self, rng: Generator, count: int) -> Params:
        """Draw random weights; biases are 0."""
        theta = {}
        for layer, (inputs, outputs) in enumerate(itertools.pairwise(LAYER_WIDTHS), 1):
            if self.bound:
                weights = (2 * draw_uniform(rng, count, outputs, inputs) - 1) * self.bound
            else:
                weights = draw_normal(rng, count, outputs, inputs) * math.sqrt((2 if layer < 3 else 1) / inputs)
            theta[f"w{layer}"] = weights
            theta[f"b{layer}"] = torch.zeros(count, outputs, 1, device=rng.device)
        return theta

    @override
    def init_encoder(self, rng: Generator) -> Params:
        """Draw a set encoder to all 675 weights; before training it predicts a random network."""
        encoder = init_set_encoder(rng, 10, ENCODER_WIDTH, sum(map(math.prod, parameter_shapes(self).values())))
        network = self.init(rng, 1)
        encoder["out.b"] = torch.cat([value.flatten() for value in network.values()])
        return encoder

    @override
    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        numbers = read_set(encoder, torch.cat([encoder_input["where"], encoder_input["target"]], 1).transpose(1, 2))
        parts = numbers.split([math.prod(shape) for shape in parameter_shapes(self).values()], 1)
        return {
            name: part.reshape(-1, *shape)
            for part, (name, shape) in zip(parts, parameter_shapes(self).items(), strict=True)
        }

    @override
    def reflectance(self, theta: Params, where: Tensor) -> Tensor:
        return torch.expm1(torch.baddbmm(theta["b3"], theta["w3"], hidden_layer(theta, where)))

    @override
    def conserve_energy(self, theta: Params) -> Params:
        hidden = hidden_layer(theta, quadrature_places(theta["w3"]))
        features = torch.cat([hidden, torch.ones_like(hidden[:, :1])], 1)
        layers = torch.cat([theta["w3"], theta["b3"]], 2)
        last = torch.stack([conserve_energy(*material) for material in zip(features, layers, strict=True)])
        return theta | {"w3": last[..., :-1].contiguous(), "b3": last[..., -1:].contiguous()}

    @override
    def fold(self, theta: Params) -> PlainLayers:
        theta = {key: value.detach().double() for key, value in theta.items()}
        return PlainLayers([(theta[f"w{layer}"], theta[f"b{layer}"].flatten()) for layer in (1, 2, 3)], "nbrdf")


NBRDF_NETWORK = Nbrdf()


def hidden_layer(theta: Params, where: Tensor) -> Tensor:
    """Return the output of the last hidden layer, [T, 21, N].

    Args:
        theta: weights and biases of T materials.
        where: half vector, difference vector and cos theta_i, [T, 7, N].
    """
    hidden = where[:, :6]
    for layer in (1, 2):
        hidden = torch.relu(torch.baddbmm(theta[f"b{layer}"], theta[f"w{layer}"], hidden))
    return hidden


def sample_weights(where: Tensor, loss_parameters: Params) -> Tensor:
    """Return learned weights of samples, [T, N], interpolated between knots over theta_h.

    Args:
        where: half vector, difference vector and cos theta_i, [T, 7, N].
        loss_parameters: the learned values, among them `weights`, log weights at the knots, [T, WEIGHT_KNOTS].
    """
    knot_position = torch.arccos(where[:, 2].clamp(-1, 1)) * ((WEIGHT_KNOTS - 1) / (math.pi / 2))
    knots = torch.arange(WEIGHT_KNOTS, device=where.device, dtype=where.dtype)
    knot_shares = (1 - (knot_position[:, None] - knots[:, None]).abs()).clamp_min(0)
    return torch.exp((loss_parameters["weights"][:, None] @ knot_shares)[:, 0])


# The set encoder: a network on each sample, the mean and the maximum over samples, and a network on both of these


def init_set_encoder(rng: Generator, inputs: int, width: int, outputs: int) -> Params:
    """Draw random parameters of a set encoder.

    Args:
        rng: the source of all draws.
        inputs: numbers of a sample.
        width: units of the layers that read single samples; layers on the set have twice as many.
        outputs: numbers that it predicts.
    """
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
    """Read samples [T, N, inputs] by a set encoder; return its predictions, [T, outputs]."""

    def apply_layer(name: str, values: Tensor) -> Tensor:
        return values @ encoder[f"{name}.w"] + encoder[f"{name}.b"]

    hidden = gelu(apply_layer("mid", gelu(apply_layer("in", samples))))
    hidden = torch.cat([hidden.mean(1), hidden.amax(1)], 1)
    hidden = layer_norm(hidden, hidden.shape[-1:])
    hidden = gelu(apply_layer("set", hidden))
    hidden = hidden + gelu(apply_layer("deep", layer_norm(hidden, hidden.shape[-1:])))
    return apply_layer("out", hidden)
