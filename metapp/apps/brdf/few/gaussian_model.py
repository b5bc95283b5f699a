"""The network of fits of few samples: a linear Gaussian model of the logarithm of reflectance.

The model adds up learned features, as Nielsen et al. 2015 ("On Optimal, Minimal BRDF Sampling for Reflectance
Acquisition") add up components of a table, but of features that any pair of directions has. The weights of a material's
features are Gaussian: one ridge regression gives their mean after samples, and their covariance is the uncertainty that
the samples leave, by which `metapp.apps.brdf.few.design` plans. Luminance varies more than colour
(:func:`metapp.apps.brdf.brdf_network.opponent_axes`). Each kind of materials has a Gaussian of its own; samples say by
their likelihood which one holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor
from torch.nn.functional import silu
from typing_extensions import override

from metapp.appearance.geometry import outgoing_cosine
from metapp.apps.brdf.brdf_network import BrdfNetwork, DistinctSamples, PlainLayers, opponent_axes
from metapp.apps.brdf.feature_network import ISOTROPIC_INPUTS, isotropic_inputs
from metapp.learning.learn import expand_tasks
from metapp.learning.task import Batch, LeastSquares, Params
from metapp.networks.coded import add_decoder, join_encoder, select_reader

DARKEST_REFLECTANCE = 1e-3  # 1/sr at normal angles, added to reflectance so that logarithms are finite
LARGEST_LOG = 14.0  # logarithm of reflectance: 1.2e6 1/sr
LUMINANCE_DEVIATION, COLOUR_DEVIATION = 0.6, 0.1  # standard deviations of features' weights before training
INITIAL_NOISE = (3.4, -3.0, 0.5)  # a, b and c of `sample_precision` before training
KIND_PARAMETERS = ("w3", "b3", "last", "deviation", "noise")  # parameters that each kind of materials has


def model_features(theta: Params, where: Tensor) -> Tensor:
    """Return features [T, F, N], the last of which is the constant 1.

    Args:
        theta: parameters of T materials.
        where: half vector, difference vector and cos theta_i, [T, 7, N].
    """
    hidden = isotropic_inputs(where)
    for layer in (1, 2):
        hidden = silu(torch.baddbmm(theta[f"b{layer}"], theta[f"w{layer}"], hidden))
    hidden = torch.baddbmm(theta["b3"], theta["w3"], hidden)
    return torch.cat([hidden, torch.ones_like(hidden[:, :1])], 1)


def cosine_product(where: Tensor) -> Tensor:
    """Return cos theta_i cos theta_o, at least DARKEST_REFLECTANCE, [T, 1, N], at `where` [T, 7, N]."""
    return (where[:, 6] * outgoing_cosine(where)).clamp_min(DARKEST_REFLECTANCE)[:, None]


def model_reflectance(theta: Params, where: Tensor) -> Tensor:
    """Return reflectance before the clamp at 0, [T, 3, N], linear RGB in 1/sr, above -1.

    Args:
        theta: parameters of T materials.
        where: half vector, difference vector and cos theta_i, [T, 7, N].
    """
    logarithms = opponent_axes(theta["last"]) @ torch.bmm(theta["last"], model_features(theta, where))
    return (logarithms.clamp(max=LARGEST_LOG).exp() - DARKEST_REFLECTANCE) / cosine_product(where)


def error_slope(reflectance: Tensor, where: Tensor) -> Tensor:
    """Return the derivative of log(1 + f cos theta_i) in the logarithm that the network adds up, [T, 3, N].

    Args:
        reflectance: f, linear RGB in 1/sr, [T, 3, N].
        where: half vector, difference vector and cos theta_i, [T, 7, N].
    """
    cosine = where[:, 6:7]
    return cosine * (reflectance + DARKEST_REFLECTANCE / cosine_product(where)) / (1 + reflectance * cosine)


def sample_precision(theta: Params, slope: Tensor) -> Tensor:
    """Return the precision of samples' logarithms, 1 over their variance, [T, N].

    It is exp(a) (slope + exp(b))^c, since dark samples say less.

    Args:
        theta: parameters of T materials, of which `noise` [T, 3] holds a, b and c.
        slope: :func:`error_slope` of the samples, [T, 3, N].
    """
    a, b, c = theta["noise"].unbind(1)
    result: Tensor = torch.exp(a)[:, None] * (slope.mean(1) + torch.exp(b)[:, None]) ** c[:, None]
    return result


def ridge_regression(theta: Params, samples: DistinctSamples) -> LeastSquares:
    """Return the ridge regression of the logarithms of samples.

    Args:
        theta: parameters of T materials.
        samples: samples of the materials, repeated to fill the batch.
    """
    where, target, distinct = samples
    cosine = where[:, 6:7]
    reflectance = torch.expm1(target) / cosine.clamp_min(1e-4)
    logarithms = (reflectance * cosine_product(where) + DARKEST_REFLECTANCE).log()
    features = model_features(theta, where)
    residual = opponent_axes(features).T @ logarithms - torch.bmm(theta["last"], features)
    slope = error_slope(reflectance, where)
    weights = sample_precision(theta, slope) * distinct[:, None]
    losses = (slope * (opponent_axes(features) @ residual)).abs().mean((1, 2))
    return LeastSquares("last", features, residual, weights, losses, torch.exp(-2 * theta["deviation"]))


def log_evidence(theta: Params, samples: DistinctSamples) -> Tensor:
    """Return the log likelihood of samples under the model, [T], up to a constant.

    The weights of features are integrated out: Rasmussen and Williams 2006, Gaussian Processes for Machine Learning,
    section 2.1.

    Args:
        theta: parameters of T materials.
        samples: samples, as :func:`ridge_regression` takes them.
    """
    regression = ridge_regression(theta, samples)
    features, residual = regression.features.double(), regression.residual.double()
    weights, count = regression.weights.double()[:, None] / features.shape[-1], samples.distinct
    prior = torch.diag_embed(torch.exp(-2 * theta["deviation"].double()))
    factor = torch.linalg.cholesky((features * weights @ features.mT)[:, None] + prior)
    moment = (residual * weights) @ features.mT
    mean_weights = torch.cholesky_solve(moment[..., None], factor)[..., 0]
    misfit = (weights * residual.square()).sum((1, 2)) - (moment * mean_weights).sum((1, 2))
    log_volume = 2 * factor.diagonal(dim1=-2, dim2=-1).log().sum((1, 2)) + 2 * theta["deviation"].double().sum((1, 2))
    log_precisions = 3 * count * (regression.weights.double() / count[:, None]).log().mean(1)
    result: Tensor = (log_precisions - misfit - log_volume) / 2
    return result


@dataclass(frozen=True)
class Few(BrdfNetwork):
    """A network of few samples: features that materials share, and Gaussians of their weights.

    Attributes:
        width: units of each of the two hidden layers.
        features: number of learned features, to which a constant is added.
        kinds: number of kinds of materials; each has a mean, deviations and features in which its materials vary
            independently.
    """

    width: int = 128
    features: int = 100
    kinds: int = 3

    @property
    @override
    def unshared_parameters(self) -> tuple[str, ...]:
        return KIND_PARAMETERS

    @property
    @override
    def linear_parameter(self) -> str:
        return "last"

    @override
    def init(self, rng: Generator, count: int) -> Params:
        """Draw random weights, equal for all materials.

        `last` [3, F], on opponent axes, begins at 0 and becomes the mean of all materials; `deviation` [3, F],
        logarithms of standard deviations, is how far materials are from it; `noise` [3] is the samples': see
        :func:`sample_precision`.
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
        return expand_tasks(theta, count, 0)

    @override
    def init_encoder(self, rng: Generator) -> Params:
        """Draw the parameters that all materials share, and KIND_PARAMETERS for each kind, [kinds, ...]."""
        theta = self.init(rng, self.kinds)
        return join_encoder({key: theta[key] for key in KIND_PARAMETERS}, theta, KIND_PARAMETERS)

    @override
    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        """Return the parameters of the kind that is likeliest to have made the samples of each task."""
        reader = select_reader(encoder)
        count = len(encoder_input["where"])
        kinds = range(len(reader["last"]))
        models = [self.select_kinds(encoder, torch.full((count,), kind)) for kind in kinds]
        with torch.no_grad():
            likeliest = torch.stack([log_evidence(theta, DistinctSamples(**encoder_input)) for theta in models]).argmax(
                0
            )
        return self.select_kinds(encoder, likeliest)

    def select_kinds(self, encoder: Params, kinds: Tensor) -> Params:
        """Return parameters [T, ...] of materials of given kinds.

        Args:
            encoder: General's encoder, which holds the parameters of all kinds.
            kinds: the kind of each material, int [T].
        """
        kinds = kinds.to(encoder["encoder.last"].device)
        return add_decoder({key: value[kinds] for key, value in select_reader(encoder).items()}, encoder)

    @override
    def reflectance(self, theta: Params, where: Tensor) -> Tensor:
        return model_reflectance(theta, where)

    @override
    def fold(self, theta: Params) -> PlainLayers:
        theta = {key: value.detach().double() for key, value in theta.items()}
        last = opponent_axes(theta["last"]) @ theta["last"]
        layers = [(theta[f"w{layer}"], theta[f"b{layer}"].flatten()) for layer in (1, 2)]
        layers.append((last[:, :-1] @ theta["w3"], (last[:, :-1] @ theta["b3"]).flatten() + last[:, -1]))
        return PlainLayers(layers, "featured", log_floor=DARKEST_REFLECTANCE)


FEW_NETWORK = Few()
