"""The network of fits of few samples: the linear Gaussian models of `metapp.extensions.few.gaussian`, one a kind."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from metapp.apps.brdf.featured import INPUTS
from metapp.apps.brdf.network import BrdfNetwork, Folded
from metapp.extensions.few import gaussian
from metapp.extensions.few.gaussian import DARKEST, opponent
from metapp.learning.task import Batch, Params
from metapp.networks.coded import encoder_of, reader_of, with_decoder

LUMINANCE, COLOUR = 0.6, 0.1  # standard deviations of features' weights before training
NOISE = (3.4, -3.0, 0.5)  # before training: see `gaussian.precision`
OF_KINDS = ("w3", "b3", "last", "deviation", "noise")


@dataclass(frozen=True)
class Few(BrdfNetwork):
    """The network's size.

    Attributes:
        width: of the two hidden layers.
        features: learned ones; a constant is one more.
        kinds: of materials; each has a mean, deviations and features in which its materials vary independently.
    """

    width: int = 128
    features: int = 100
    kinds: int = 3

    @property
    def task_parameters(self) -> tuple[str, ...]:
        return OF_KINDS

    @property
    def linear_parameter(self) -> str:
        return "last"

    def init(self, rng: Generator, count: int) -> Params:
        """Random weights, the same for all.

        `last` [3, F], on opponent axes, begins as the mean of all materials; `deviation` [3, F], logarithms, is how far
        materials are from it; `noise` [3] is that of samples.
        """
        sizes = {"w1": (self.width, INPUTS), "w2": (self.width, self.width), "w3": (self.features, self.width)}
        theta = {}
        for name, (rows, columns) in sizes.items():
            noise = torch.randn(rows, columns, generator=rng, device=rng.device)
            theta[name] = noise * math.sqrt((2 if name != "w3" else 1) / columns)
            theta[name.replace("w", "b")] = torch.zeros(rows, 1, device=rng.device)
        theta["last"] = torch.zeros(3, self.features + 1, device=rng.device)
        deviations = torch.tensor([LUMINANCE, COLOUR, COLOUR], device=rng.device).log()
        theta["deviation"] = deviations[:, None].expand_as(theta["last"]).contiguous()
        theta["noise"] = torch.tensor(NOISE, device=rng.device)
        return {key: value.expand(count, *value.shape) for key, value in theta.items()}

    def init_encoder(self, rng: Generator) -> Params:
        """What all materials share, and OF_KINDS for each kind, [kinds, ...]."""
        theta = self.init(rng, self.kinds)
        return encoder_of({key: theta[key] for key in OF_KINDS}, theta, OF_KINDS)

    def encode(self, encoder: Params, condition: Batch) -> Params:
        """Parameters of the kind that is likeliest to have made the samples, as `FewSamples.sample` gives them."""
        kinds = reader_of(encoder)
        count = len(condition["where"])
        every = [self.of_kinds(encoder, torch.full((count,), kind)) for kind in range(len(kinds["last"]))]
        with torch.no_grad():
            likeliest = torch.stack([gaussian.evidence(theta, condition) for theta in every]).argmax(0)
        return self.of_kinds(encoder, likeliest)

    def of_kinds(self, encoder: Params, which: Tensor) -> Params:
        """Parameters [T, ...] of materials of these kinds, int [T]."""
        which = which.to(encoder["encoder.last"].device)
        return with_decoder({key: value[which] for key, value in reader_of(encoder).items()}, encoder)

    def reflectance(self, theta: Params, where: Tensor) -> Tensor:
        return gaussian.reflectance_of(theta, where)

    def folded(self, theta: Params) -> Folded:
        theta = {key: value.detach().double() for key, value in theta.items()}
        last = opponent(theta) @ theta["last"]
        layers = [(theta[f"w{layer}"], theta[f"b{layer}"].flatten()) for layer in (1, 2)]
        layers.append((last[:, :-1] @ theta["w3"], (last[:, :-1] @ theta["b3"]).flatten() + last[:, -1]))
        return Folded(layers, "featured", darkest=DARKEST)


NETWORK = Few()
