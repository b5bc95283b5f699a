"""The network of fits of few samples, a linear Gaussian model: a mean, learned features, how far materials vary.

It adds up logarithms of reflectance, as the components of Nielsen et al. 2015 ("On Optimal, Minimal BRDF
Sampling for Reflectance Acquisition") do, but of features that any direction has. A material is Gaussian in their
weights, so that one ridge regression gives its mean, and its covariance is the uncertainty that the samples leave:
`metapp.apps.brdf.few.design` measures and plans by it. Luminance varies more than colour does: `opponent_axes`. There
is a Gaussian for each kind of materials; samples say by their likelihood which one holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor
from torch.nn.functional import silu

from metapp.appearance.geometry import outgoing_cosine
from metapp.apps.brdf.brdf_network import COUNT_KEY, BrdfNetwork, PlainLayers, opponent_axes
from metapp.apps.brdf.feature_network import ISOTROPIC_INPUTS, isotropic_inputs
from metapp.learning.task import Batch, LeastSquares, Params
from metapp.networks.coded import add_decoder, join_encoder, select_reader

DARKEST_REFLECTANCE = 1e-3  # 1/sr, at normal angles: what keeps logarithms finite
LARGEST_LOG = 14.0  # logarithm of reflectance: 1.2e6 1/sr
LUMINANCE_DEVIATION, COLOUR_DEVIATION = 0.6, 0.1  # standard deviations of features' weights before training
INITIAL_NOISE = (3.4, -3.0, 0.5)  # before training: see `sample_precision`
KIND_PARAMETERS = ("w3", "b3", "last", "deviation", "noise")


def model_features(theta: Params, where: Tensor) -> Tensor:
    """Features [T, F, N] of half vector, difference vector and cos theta_i, [T, 7, N]; the last one is 1."""
    x = isotropic_inputs(where)
    for layer in (1, 2):
        x = silu(torch.baddbmm(theta[f"b{layer}"], theta[f"w{layer}"], x))
    x = torch.baddbmm(theta["b3"], theta["w3"], x)
    return torch.cat([x, torch.ones_like(x[:, :1])], 1)


def cosine_product(where: Tensor) -> Tensor:
    """Cos theta_i cos theta_o, DARKEST at least, [T, 1, N] of [T, 7, N]."""
    return (where[:, 6] * outgoing_cosine(where)).clamp_min(DARKEST_REFLECTANCE)[:, None]


def model_reflectance(theta: Params, where: Tensor) -> Tensor:
    """Reflectance before the clamp at 0, [T, 3, N], linear RGB in 1/sr, above -1."""
    logarithms = opponent_axes(theta["last"]) @ torch.bmm(theta["last"], model_features(theta, where))
    return (logarithms.clamp(max=LARGEST_LOG).exp() - DARKEST_REFLECTANCE) / cosine_product(where)


def error_slope(reflectance: Tensor, where: Tensor) -> Tensor:
    """The slope of log(1 + f cos theta_i) over the logarithm that the network adds up, [T, 3, N] of reflectance f."""
    cos = where[:, 6:7]
    return cos * (reflectance + DARKEST_REFLECTANCE / cosine_product(where)) / (1 + reflectance * cos)


def sample_precision(theta: Params, slope: Tensor) -> Tensor:
    """The precision of the logarithms of samples, 1 over their variance, [T, N] of their slopes [T, 3, N].

    As `noise` (a, b, c) says it: exp(a) (slope + exp(b))^c, since dark samples say less.
    """
    a, b, c = theta["noise"].unbind(1)
    result: Tensor = torch.exp(a)[:, None] * (slope.mean(1) + torch.exp(b)[:, None]) ** c[:, None]
    return result


def ridge_regression(theta: Params, batch: Batch) -> LeastSquares:
    """The ridge regression of samples that are repeated to fill the batch, `count` [T] different ones."""
    where, target = batch["where"], batch["target"]
    cos = where[:, 6:7]
    seen = torch.expm1(target) / cos.clamp_min(1e-4)
    logarithms = (seen * cosine_product(where) + DARKEST_REFLECTANCE).log()
    features = model_features(theta, where)
    residual = opponent_axes(features).T @ logarithms - torch.bmm(theta["last"], features)
    slope = error_slope(seen, where)
    weights = sample_precision(theta, slope) * batch[COUNT_KEY][:, None]
    losses = (slope * (opponent_axes(features) @ residual)).abs().mean((1, 2))
    return LeastSquares("last", features, residual, weights, losses, torch.exp(-2 * theta["deviation"]))


def log_evidence(theta: Params, batch: Batch) -> Tensor:
    """The log likelihood [T] of the samples under the model, but for a constant.

    With weights integrated out: Rasmussen and Williams 2006, Gaussian Processes for Machine Learning, section 2.1.
    """
    at = ridge_regression(theta, batch)
    features, residual = at.features.double(), at.residual.double()
    weights, count = at.weights.double()[:, None] / features.shape[-1], batch[COUNT_KEY]
    prior = torch.diag_embed(torch.exp(-2 * theta["deviation"].double()))
    factor = torch.linalg.cholesky((features * weights @ features.mT)[:, None] + prior)
    moment = (residual * weights) @ features.mT
    solved = torch.cholesky_solve(moment[..., None], factor)[..., 0]
    missed = (weights * residual.square()).sum((1, 2)) - (moment * solved).sum((1, 2))
    volume = 2 * factor.diagonal(dim1=-2, dim2=-1).log().sum((1, 2)) + 2 * theta["deviation"].double().sum((1, 2))
    precisions = 3 * count * (at.weights.double() / count[:, None]).log().mean(1)
    result: Tensor = (precisions - missed - volume) / 2
    return result


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
    def unshared_parameters(self) -> tuple[str, ...]:
        return KIND_PARAMETERS

    @property
    def linear_parameter(self) -> str:
        return "last"

    def init(self, rng: Generator, count: int) -> Params:
        """Random weights, the same for all.

        `last` [3, F], on opponent axes, begins as the mean of all materials; `deviation` [3, F], logarithms, is how far
        materials are from it; `noise` [3] is that of samples.
        """
        sizes = {
            "w1": (self.width, ISOTROPIC_INPUTS),
            "w2": (self.width, self.width),
            "w3": (self.features, self.width),
        }
        theta = {}
        for name, (rows, columns) in sizes.items():
            noise = torch.randn(rows, columns, generator=rng, device=rng.device)
            theta[name] = noise * math.sqrt((2 if name != "w3" else 1) / columns)
            theta[name.replace("w", "b")] = torch.zeros(rows, 1, device=rng.device)
        theta["last"] = torch.zeros(3, self.features + 1, device=rng.device)
        deviations = torch.tensor([LUMINANCE_DEVIATION, COLOUR_DEVIATION, COLOUR_DEVIATION], device=rng.device).log()
        theta["deviation"] = deviations[:, None].expand_as(theta["last"]).contiguous()
        theta["noise"] = torch.tensor(INITIAL_NOISE, device=rng.device)
        return {key: value.expand(count, *value.shape) for key, value in theta.items()}

    def init_encoder(self, rng: Generator) -> Params:
        """The parameters that all materials share, and OF_KINDS for each kind, [kinds, ...]."""
        theta = self.init(rng, self.kinds)
        return join_encoder({key: theta[key] for key in KIND_PARAMETERS}, theta, KIND_PARAMETERS)

    def encode(self, encoder: Params, condition: Batch) -> Params:
        """Parameters of the kind that is likeliest to have made the samples, as `FewSamples.sample` gives them."""
        kinds = select_reader(encoder)
        count = len(condition["where"])
        every = [self.of_kinds(encoder, torch.full((count,), kind)) for kind in range(len(kinds["last"]))]
        with torch.no_grad():
            likeliest = torch.stack([log_evidence(theta, condition) for theta in every]).argmax(0)
        return self.of_kinds(encoder, likeliest)

    def of_kinds(self, encoder: Params, which: Tensor) -> Params:
        """Parameters [T, ...] of materials of these kinds, int [T]."""
        which = which.to(encoder["encoder.last"].device)
        return add_decoder({key: value[which] for key, value in select_reader(encoder).items()}, encoder)

    def reflectance(self, theta: Params, where: Tensor) -> Tensor:
        return model_reflectance(theta, where)

    def folded(self, theta: Params) -> PlainLayers:
        theta = {key: value.detach().double() for key, value in theta.items()}
        last = opponent_axes(theta["last"]) @ theta["last"]
        layers = [(theta[f"w{layer}"], theta[f"b{layer}"].flatten()) for layer in (1, 2)]
        layers.append((last[:, :-1] @ theta["w3"], (last[:, :-1] @ theta["b3"]).flatten() + last[:, -1]))
        return PlainLayers(layers, "featured", darkest=DARKEST_REFLECTANCE)


FEW_NETWORK = Few()
