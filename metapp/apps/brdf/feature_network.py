"""A network of learned features: many weights that all materials share, and few that each material has.

Features of a pair of directions are learned on all training materials. A material has a code, which scales and shifts
their hidden layers (FiLM, Perez et al. 2018), and a last, linear layer, which combines the features and which least
squares can solve for (`metapp.learning.rules.solve`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Generator, Tensor
from torch.nn.functional import silu
from typing_extensions import override

from metapp.appearance.geometry import rotate_about_normal
from metapp.apps.brdf import anisotropic
from metapp.apps.brdf.brdf_network import BrdfNetwork, PlainLayers
from metapp.apps.brdf.energy import conserve_energy, quadrature_places
from metapp.apps.brdf.highlight import MANY_SAMPLES, hold_last_layer
from metapp.apps.brdf.nbrdf_network import init_set_encoder, read_set
from metapp.apps.brdf.sample_augmentation import draw_measurements
from metapp.learning.random_tensors import draw_normal, draw_uniform
from metapp.learning.task import Batch, Params
from metapp.networks.coded import add_decoder, join_encoder, select_reader

ISOTROPIC_INPUTS = 15  # numbers that the network reads of a pair of directions
AZIMUTH_ONSET_RAD2 = 0.01  # theta_h^2 in rad^2 around which inputs that depend on phi_d grow from 0
# added to the squares of vectors and of cosines whose roots are inputs, which so have a slope of 0 where signs change
VECTOR_SMOOTHING, COSINE_SMOOTHING = 1e-4, 1e-6
AXES_AZIMUTH_KEY = "axes_azimuth_rad"  # a parameter that each anisotropic material has


@dataclass(frozen=True)
class Featured(BrdfNetwork):
    """A network of features that all materials share; a material is a code and a linear last layer.

    Attributes:
        width: units of each of the two hidden layers.
        features: number of learned features, to which a constant is added.
        code: length of a material's code.
        encoder: width of the set encoder.
        anisotropic: whether it reads phi_h, in axes that it finds in the samples (`metapp.apps.brdf.anisotropic`).
    """

    width: int = 96
    features: int = 60
    code: int = 12
    encoder: int = 64
    anisotropic: bool = False

    @property
    def inputs(self) -> int:
        """The count of numbers that the network reads of a pair of directions."""
        return anisotropic.ANISOTROPIC_INPUTS if self.anisotropic else ISOTROPIC_INPUTS

    @property
    @override
    def unshared_parameters(self) -> tuple[str, ...]:
        return ("z", "last", AXES_AZIMUTH_KEY) if self.anisotropic else ("z", "last")

    @property
    @override
    def linear_parameter(self) -> str:
        return "last"

    @override
    def init(self, rng: Generator, count: int) -> Params:
        """Draw random weights; biases, codes and last layers are 0."""
        sizes = {"w1": (self.width, self.inputs), "w2": (self.width, self.width), "w3": (self.features, self.width)}
        theta = {}
        for name, (rows, columns) in sizes.items():
            noise = draw_normal(rng, count, rows, columns)
            theta[name] = noise * math.sqrt((2 if name != "w3" else 1) / columns)
            theta[name.replace("w", "b")] = torch.zeros(count, rows, 1, device=rng.device)
        for name in ("film1", "film2"):
            noise = draw_normal(rng, count, 2 * self.width, self.code)
            theta[name] = noise * 0.1 / math.sqrt(self.code)
        theta["z"] = torch.zeros(count, self.code, 1, device=rng.device)
        if self.anisotropic:
            theta[AXES_AZIMUTH_KEY] = torch.zeros(count, 1, device=rng.device)
        return theta | {"last": torch.zeros(count, 3, self.features + 1, device=rng.device)}

    @override
    def init_encoder(self, rng: Generator) -> Params:
        """Draw a set encoder that predicts a code and a last layer, and the weights that all materials share."""
        outputs = self.code + 3 * (self.features + 1)
        reader = init_set_encoder(rng, self.inputs + 3, self.encoder, outputs)
        return join_encoder(reader, self.init(rng, 1), self.unshared_parameters)

    @override
    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        """Predict a code and a last layer from samples, find axes if there are any, and add the shared weights."""
        axes = {AXES_AZIMUTH_KEY: anisotropic.find_axes(encoder_input)} if self.anisotropic else {}
        inputs = self._make_inputs(axes, encoder_input["where"])
        samples = torch.cat([inputs, encoder_input["target"]], 1).transpose(1, 2)
        code, last = read_set(select_reader(encoder), samples).split([self.code, 3 * (self.features + 1)], 1)
        return add_decoder(axes | {"z": code[..., None], "last": last.reshape(len(last), 3, -1)}, encoder)

    def _make_inputs(self, theta: Params, where: Tensor) -> Tensor:
        """Return the network's input, [T, inputs, N], at `where` [T, 7, N]."""
        return (
            anisotropic.anisotropic_inputs(where, theta[AXES_AZIMUTH_KEY])
            if self.anisotropic
            else isotropic_inputs(where)
        )

    @override
    def linear_features(self, theta: Params, where: Tensor) -> Tensor:
        """Return features [T, F, N], the last of which is the constant 1."""
        hidden = self._make_inputs(theta, where)
        for layer in (1, 2):
            gain, shift = (theta[f"film{layer}"] @ theta["z"]).chunk(2, 1)
            weights, bias = theta[f"w{layer}"] * (1 + gain), theta[f"b{layer}"] * (1 + gain) + shift
            hidden = silu(torch.baddbmm(bias, weights, hidden))
        hidden = torch.baddbmm(theta["b3"], theta["w3"], hidden)
        return torch.cat([hidden, torch.ones_like(hidden[:, :1])], 1)

    @override
    def reflectance(self, theta: Params, where: Tensor) -> Tensor:
        return torch.expm1(torch.bmm(theta["last"], self.linear_features(theta, where)))

    @property
    @override
    def can_conserve_energy(self) -> bool:
        return not self.anisotropic

    @override
    def conserve_energy(self, theta: Params) -> Params:
        features = self.linear_features(theta, quadrature_places(theta["last"]))
        last = [conserve_energy(*material) for material in zip(features, theta["last"], strict=True)]
        return theta | {"last": torch.stack(last)}

    @override
    def hold_highlight(self, theta: Params, seen: Any) -> Params:
        """Hold isotropic fits of no more than MANY_SAMPLES; see :func:`hold_last_layer`."""
        if self.anisotropic or seen.where.shape[-1] > MANY_SAMPLES:
            return theta
        layers = []
        for i, last in enumerate(theta["last"]):
            material = {key: value[i : i + 1] for key, value in theta.items()}

            def find_features(where: Tensor, material: Params = material) -> Tensor:
                return self.linear_features(material, where.to(material["last"]))[0]

            layers.append(hold_last_layer(find_features, last, seen.where[i], seen.target[i]))
        return theta | {"last": torch.stack(layers)}

    @override
    def augment(self, data: Params, rng: Generator) -> Params:
        """Return samples as instruments take them (:func:`draw_measurements`); turn anisotropic materials at random."""
        data = draw_measurements(data, rng)
        if not self.anisotropic:
            return data
        turn = 2 * math.pi * draw_uniform(rng, len(data["where"]), 1)
        half, difference_and_cosine = data["where"].split((3, 4), -1)
        return data | {"where": torch.cat([rotate_about_normal(half, turn), difference_and_cosine], -1)}

    @override
    def fold(self, theta: Params) -> PlainLayers:
        """Multiply the code into the hidden layers, and the features' own layer into the last one."""
        theta = {key: value.detach().double() for key, value in theta.items()}
        layers = []
        for layer in ("1", "2"):
            gain, shift = (theta[f"film{layer}"] @ theta["z"]).chunk(2)
            bias = theta[f"b{layer}"] * (1 + gain) + shift
            layers.append((theta[f"w{layer}"] * (1 + gain), bias.flatten()))
        last, constant = theta["last"][:, :-1], theta["last"][:, -1]
        layers.append((last @ theta["w3"], (last @ theta["b3"]).flatten() + constant))
        if self.anisotropic:
            return PlainLayers(layers, "anisotropic", float(theta[AXES_AZIMUTH_KEY]))
        return PlainLayers(layers, "featured")


FEATURED_NETWORK, ANISOTROPIC_NETWORK = Featured(), Featured(anisotropic=True)


def isotropic_inputs(where: Tensor) -> Tensor:
    """Return the input of a network of isotropic BRDFs, [T, ISOTROPIC_INPUTS, N].

    Inputs are equal at phi_d, -phi_d and phi_d + pi, and at all phi_d where the half vector is the normal. They are the
    vectors, both cosines, and functions of theta_h in which narrow and broad lobes are equally wide.

    Args:
        where: half vector, difference vector and cos theta_i, [T, 7, N].
    """
    half_x, half_y, half_z, x, y, z, _ = where.unbind(1)
    polar_square = (theta_h := torch.atan2(half_x, half_z)).square()
    sine_square, elongation = x * x + y * y, polar_square / (polar_square + AZIMUTH_ONSET_RAD2) * (x * x - y * y)
    squares = (sine_square + elongation) / 2, (sine_square - elongation) / 2
    along, across = ((square + VECTOR_SMOOTHING).sqrt() for square in squares)
    cos_low, cos_high = (half_z * z + sign * ((half_x * x).square() + COSINE_SMOOTHING).sqrt() for sign in (-1, 1))
    logs = [polar_square + 1e-4, polar_square + 1e-2, cos_low.clamp_min(1e-3), cos_high.clamp_min(1e-3)]
    inputs = [half_x, half_y, half_z, along, across, z, cos_low, cos_high]
    inputs += [theta_h.sqrt(), 1 / (1 + 100 * polar_square), elongation]
    return torch.cat([torch.stack(inputs, 1), 0.4 * torch.stack(logs, 1).log() + 1], 1)
