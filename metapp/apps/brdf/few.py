"""A linear Gaussian model of BRDFs, for fits of few samples: a mean, learned features, and how far materials vary.

Logarithms of reflectance are what it adds up, as the components of Nielsen et al. 2015 ("On Optimal, Minimal BRDF
Sampling for Reflectance Acquisition") do, but of features that any direction has. A material is Gaussian in their
weights, so that one ridge regression gives its mean, and its covariance says what the samples leave open:
`metapp.apps.brdf.design` measures and plans by it. Luminance varies more than colour does: OPPONENT axes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import silu

from metapp.apps.brdf.featured import INPUTS, inputs_of, outgoing_cosine
from metapp.learning.task import Batch, Linear, Params

MOST = 512  # samples of which a material has few at most
TABLE = 32  # samples of a table, which has more, that a fit sees: the first ones
DARKEST = 1e-3  # 1/sr, at normal angles: what keeps logarithms finite
LARGEST = 14.0  # logarithm of reflectance: 1.2e6 1/sr
LUMINANCE, COLOUR = 0.6, 0.1  # standard deviations of features' weights before training
NOISE = (3.4, -3.0, 0.5)  # before training: see `precision`
# columns: luminance, and two axes of colour, of unit length
OPPONENT = ((3**-0.5, 2**-0.5, 6**-0.5), (3**-0.5, 0.0, -2 * 6**-0.5), (3**-0.5, -(2**-0.5), 6**-0.5))


class Few(NamedTuple):
    """The network's size.

    Attributes:
        width: of the two hidden layers.
        features: learned ones; a constant is one more.
    """

    width: int = 128
    features: int = 100

    @property
    def own(self) -> tuple[str, ...]:
        """What a material does not share with others."""
        return ("last",)

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


def features_of(theta: Params, where: Tensor) -> Tensor:
    """Features [T, F, N] of half vector, difference vector and cos theta_i, [T, 7, N]; the last one is 1."""
    x = inputs_of(where)
    for layer in (1, 2):
        x = silu(torch.baddbmm(theta[f"b{layer}"], theta[f"w{layer}"], x))
    x = torch.baddbmm(theta["b3"], theta["w3"], x)
    return torch.cat([x, torch.ones_like(x[:, :1])], 1)


def opponent(theta: Params) -> Tensor:
    """The matrix [3, 3] from opponent axes to linear RGB; its transpose is its inverse."""
    return theta["last"].new_tensor(OPPONENT)


def cosine_product(where: Tensor) -> Tensor:
    """Cos theta_i cos theta_o, DARKEST at least, [T, 1, N] of [T, 7, N]."""
    return (where[:, 6] * outgoing_cosine(where)).clamp_min(DARKEST)[:, None]


def reflectance_of(theta: Params, where: Tensor) -> Tensor:
    """Reflectance before the clamp at 0, [T, 3, N], linear RGB in 1/sr, above -1."""
    logarithms = opponent(theta) @ torch.bmm(theta["last"], features_of(theta, where))
    return (logarithms.clamp(max=LARGEST).exp() - DARKEST) / cosine_product(where)


def slope_of(reflectance: Tensor, where: Tensor) -> Tensor:
    """How log(1 + f cos theta_i) changes with the logarithm that the network adds up, [T, 3, N] of reflectance f."""
    cos = where[:, 6:7]
    return cos * (reflectance + DARKEST / cosine_product(where)) / (1 + reflectance * cos)


def precision(theta: Params, slope: Tensor) -> Tensor:
    """How certain the logarithms of samples are, 1 over their variance, [T, N] of their slopes [T, 3, N].

    As `noise` (a, b, c) says it: exp(a) (slope + exp(b))^c, since dark samples say less.
    """
    a, b, c = theta["noise"].unbind(1)
    result: Tensor = torch.exp(a)[:, None] * (slope.mean(1) + torch.exp(b)[:, None]) ** c[:, None]
    return result


def linear(theta: Params, batch: Batch) -> Linear:
    """The ridge regression of samples that are repeated to fill the batch, `count` [T] different ones."""
    where, target = batch["where"], batch["target"]
    cos = where[:, 6:7]
    seen = torch.expm1(target) / cos.clamp_min(1e-4)
    logarithms = (seen * cosine_product(where) + DARKEST).log()
    features = features_of(theta, where)
    residual = opponent(theta).T @ logarithms - torch.bmm(theta["last"], features)
    slope = slope_of(seen, where)
    weights = precision(theta, slope) * batch["count"][:, None]
    losses = (slope * (opponent(theta) @ residual)).abs().mean((1, 2))
    return Linear("last", features, residual, weights, losses, torch.exp(-2 * theta["deviation"]))


def condensed(data: Params) -> Params:
    """Samples `where` [N, 7], `target` [N, 3] with those that a fit sees in front, none twice, and their `count`.

    Of a table, which has more than MOST samples, a fit sees the first TABLE of them.
    """
    half = len(data["where"]) // 2
    _, which = torch.unique(data["where"][:half], dim=0, return_inverse=True)
    first = torch.full((int(which.max()) + 1,), half).scatter_reduce(0, which, torch.arange(half), "amin")
    if len(first) > MOST:
        return data | {"count": torch.tensor(float(TABLE))}
    order = torch.arange(len(data["where"]))
    order[: len(first)] = first.sort().values
    return {key: value[order] for key, value in data.items()} | {"count": torch.tensor(float(len(first)))}


def folded(theta: Params) -> list[tuple[Tensor, Tensor]]:
    """One material's network as three plain layers, from `inputs_of` to logarithms of RGB, hidden ones with SiLU.

    Args:
        theta: parameters of one task, without a task axis.

    Returns:
        Weights [out, in] and biases [out], float64.
    """
    theta = {key: value.detach().double() for key, value in theta.items()}
    last = opponent(theta) @ theta["last"]
    layers = [(theta[f"w{layer}"], theta[f"b{layer}"].flatten()) for layer in (1, 2)]
    return [*layers, (last[:, :-1] @ theta["w3"], (last[:, :-1] @ theta["b3"]).flatten() + last[:, -1])]
