"""A network of many weights that all materials share and few that each has: a code and the last, linear layer.

Features of a pair of directions are learned on all training materials; the code scales and shifts their hidden layers
(FiLM, Perez et al. 2018), and a material is a linear combination of them, which least squares can solve for
(`metapp.learning.rules.solve`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor
from torch.nn.functional import silu

from metapp.appearance.geometry import rotate_about_normal
from metapp.apps.brdf import anisotropic
from metapp.apps.brdf.brdf_network import BrdfNetwork, PlainLayers
from metapp.apps.brdf.energy import conserve_energy, quadrature_places
from metapp.apps.brdf.nbrdf_network import init_set_encoder, read_set
from metapp.apps.brdf.sample_augmentation import draw_measurements
from metapp.learning.random_tensors import draw_normal, draw_uniform
from metapp.learning.task import Batch, Params
from metapp.networks.coded import add_decoder, join_encoder, select_reader

ISOTROPIC_INPUTS = 15
AZIMUTH_ONSET_RAD2 = 0.01  # theta_h^2 in rad^2 about which what depends on phi_d grows from 0
VECTOR_SMOOTHING, COSINE_SMOOTHING = (
    1e-4,
    1e-6,
)  # of squares, of vectors and of cosines: where signs change, inputs have a slope of 0
TURN_KEY = "turn"  # of an anisotropic material, its own: the azimuth of its axes


@dataclass(frozen=True)
class Featured(BrdfNetwork):
    """A network of features that all materials share; a material is a code and a linear last layer.

    Attributes:
        width: of the two hidden layers.
        features: learned ones; a constant is one more.
        code: numbers of the code.
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
        """The count of numbers of a pair of directions that it reads."""
        return anisotropic.ANISOTROPIC_INPUTS if self.anisotropic else ISOTROPIC_INPUTS

    @property
    def unshared_parameters(self) -> tuple[str, ...]:
        return ("z", "last", TURN_KEY) if self.anisotropic else ("z", "last")

    @property
    def linear_parameter(self) -> str:
        return "last"

    def init(self, rng: Generator, count: int) -> Params:
        """Random weights, the same for all but for the code: 0."""
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
            theta[TURN_KEY] = torch.zeros(count, 1, device=rng.device)
        return theta | {"last": torch.zeros(count, 3, self.features + 1, device=rng.device)}

    def init_encoder(self, rng: Generator) -> Params:
        """A set encoder to a code and a last layer, and the weights that all materials share."""
        numbers = self.code + 3 * (self.features + 1)
        reader = init_set_encoder(rng, self.inputs + 3, self.encoder, numbers)
        return join_encoder(reader, self.init(rng, 1), self.unshared_parameters)

    def encode(self, encoder: Params, condition: Batch) -> Params:
        """A code and a last layer from samples, beside the shared weights."""
        own = {TURN_KEY: anisotropic.find_axes(condition)} if self.anisotropic else {}
        samples = torch.cat([self._read(own, condition["where"]), condition["target"]], 1).transpose(1, 2)
        z, last = read_set(select_reader(encoder), samples).split([self.code, 3 * (self.features + 1)], 1)
        return add_decoder(own | {"z": z[..., None], "last": last.reshape(len(last), 3, -1)}, encoder)

    def _read(self, theta: Params, where: Tensor) -> Tensor:
        """The network's input, [T, inputs, N] of places [T, 7, N]."""
        return anisotropic.anisotropic_inputs(where, theta[TURN_KEY]) if self.anisotropic else isotropic_inputs(where)

    def features_of(self, theta: Params, where: Tensor) -> Tensor:
        """Features [T, F, N] of half vector, difference vector and cos theta_i, [T, 7, N]; the last one is 1."""
        x = self._read(theta, where)
        for layer in (1, 2):
            gain, shift = (theta[f"film{layer}"] @ theta["z"]).chunk(2, 1)
            weights, bias = theta[f"w{layer}"] * (1 + gain), theta[f"b{layer}"] * (1 + gain) + shift
            x = silu(torch.baddbmm(bias, weights, x))
        x = torch.baddbmm(theta["b3"], theta["w3"], x)
        return torch.cat([x, torch.ones_like(x[:, :1])], 1)

    def reflectance(self, theta: Params, where: Tensor) -> Tensor:
        """exp(last layer) - 1."""
        return torch.expm1(torch.bmm(theta["last"], self.features_of(theta, where)))

    @property
    def can_conserve(self) -> bool:
        return not self.anisotropic

    def conserved(self, theta: Params) -> Params:
        """With a last layer that reflects no more than all."""
        features = self.features_of(theta, quadrature_places(theta["last"]))
        last = [conserve_energy(*each) for each in zip(features, theta["last"], strict=True)]
        return theta | {"last": torch.stack(last)}

    def augment(self, data: Params, rng: Generator) -> Params:
        """Return samples as instruments take them (`draw_measurements`); anisotropic materials are turned."""
        data = draw_measurements(data, rng)
        if not self.anisotropic:
            return data
        turn = 2 * math.pi * draw_uniform(rng, len(data["where"]), 1)
        half, rest = data["where"].split((3, 4), -1)
        return data | {"where": torch.cat([rotate_about_normal(half, turn), rest], -1)}

    def folded(self, theta: Params) -> PlainLayers:
        """The code and the features' own layer are multiplied out."""
        theta = {key: value.detach().double() for key, value in theta.items()}
        layers = []
        for layer in ("1", "2"):
            gain, shift = (theta[f"film{layer}"] @ theta["z"]).chunk(2)
            bias = theta[f"b{layer}"] * (1 + gain) + shift
            layers.append((theta[f"w{layer}"] * (1 + gain), bias.flatten()))
        last, constant = theta["last"][:, :-1], theta["last"][:, -1]
        layers.append((last @ theta["w3"], (last @ theta["b3"]).flatten() + constant))
        if self.anisotropic:
            return PlainLayers(layers, "anisotropic", float(theta[TURN_KEY]))
        return PlainLayers(layers, "featured")


FEATURED_NETWORK, ANISOTROPIC_NETWORK = Featured(), Featured(anisotropic=True)


def isotropic_inputs(where: Tensor) -> Tensor:
    """The network's input [T, INPUTS, N] of half vector and difference vector, [T, 7, N].

    The same at phi_d, -phi_d and phi_d + pi, and for any phi_d where the half vector is the normal. Beside the vectors
    both cosines, and functions of theta_h in which narrow and broad lobes are equally wide.
    """
    half_x, nothing, half_z, x, y, z, _ = where.unbind(1)
    square = (angle := torch.atan2(half_x, half_z)).square()
    both, apart = x * x + y * y, square / (square + AZIMUTH_ONSET_RAD2) * (x * x - y * y)
    along, across = ((both + apart) / 2 + VECTOR_SMOOTHING).sqrt(), ((both - apart) / 2 + VECTOR_SMOOTHING).sqrt()
    lower, higher = (half_z * z + sign * ((half_x * x).square() + COSINE_SMOOTHING).sqrt() for sign in (-1, 1))
    logs = torch.stack([square + 1e-4, square + 1e-2, lower.clamp_min(1e-3), higher.clamp_min(1e-3)], 1).log()
    plain = [half_x, nothing, half_z, along, across, z, lower, higher, angle.sqrt(), 1 / (1 + 100 * square), apart]
    return torch.cat([torch.stack(plain, 1), 0.4 * logs + 1], 1)
