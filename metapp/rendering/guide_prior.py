"""The prior of a guide cache: a small network that estimates densities before paths have filled the histograms.

It maps pictures over the bins of directions of one entry, [SIDE, SIDE] each, to how densely paths should be sampled
there. It knows nothing else of a scene. General trains it on rooms (`metapp.rendering.guide_training`).
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import torch
from torch import Generator, Tensor
from torch.nn.functional import conv2d, silu

from metapp.learning.task import Params
from metapp.networks.layers import add_layer
from metapp.rendering.guide_features import CHANNELS, SurveyFeatures
from metapp.rendering.guide_histogram import BINS, DEFENSIVE, POWER, SIDE, log_relative, second_moments
from metapp.storage.records import load_checkpoint

NAME = "guiding"
FEATURES = len(CHANNELS) + 3
HIDDEN = 16
_ESTIMATE = len(CHANNELS)  # the feature that holds the histogram's own estimate


def shipped() -> Path:
    """The checkpoint that ships."""
    return Path(str(resources.files("metapp.checkpoints"))) / NAME / "general.safetensors"


def read_prior(path: Path) -> Params:
    """The network's parameters from a checkpoint.

    Raises:
        ValueError: it is none, or of another network.
    """
    prepared, _ = load_checkpoint(path)
    expected = {key: value.shape for key, value in init(Generator().manual_seed(0)).items()}
    if {key: value.shape for key, value in prepared.encoder.items()} != expected:
        raise ValueError(f"{path}: a checkpoint of another network, expected one of guide priors ({NAME}).")
    return {key: value.float() for key, value in prepared.encoder.items()}


def init(rng: Generator) -> Params:
    """Parameters by which the network returns the histogram's own estimate."""
    theta: Params = {}
    add_layer(theta, rng, "first", HIDDEN, FEATURES, 3, 3)
    add_layer(theta, rng, "second", HIDDEN, HIDDEN, 3, 3)
    theta["out.kernel"] = torch.zeros(1, HIDDEN, 1, 1)
    theta["past.kernel"] = torch.zeros(1, FEATURES, 1, 1)
    theta["past.kernel"][0, _ESTIMATE] = POWER
    return theta


def densities(theta: Params, features: Tensor) -> Tensor:
    """How densely directions should be sampled.

    Args:
        theta: the network's.
        features: [P, FEATURES, SIDE, SIDE], of any entries.

    Returns:
        [P, BINS], of sum 1, each at least 1 / DEFENSIVE of the uniform density.
    """
    share = logits(theta, features).softmax(1)
    return 1 / (DEFENSIVE * BINS) + (1 - 1 / DEFENSIVE) * share


def logits(theta: Params, features: Tensor) -> Tensor:
    """Logarithms of the part of the densities that is free, [P, BINS], to a constant."""
    first = silu(conv2d(features, theta["first.kernel"], theta["first.shift"], padding=1))
    second = silu(conv2d(first, theta["second.kernel"], theta["second.shift"], padding=1) + first)
    return (conv2d(second, theta["out.kernel"]) + conv2d(features, theta["past.kernel"])).flatten(1)


def histogram_features(squares: Tensor, counts: Tensor, moments: Tensor) -> Tensor:
    """Features of what paths have found.

    Args:
        squares, counts: sums, [P, SIDE, SIDE], as of `second_moments`.
        moments: second moments estimated from these, of the same shape.

    Returns:
        [P, 3, SIDE, SIDE]: the moments' logarithms, how many paths a bin had, how many the entry.
    """
    paths = counts.flatten(1).sum(1).log1p()[:, None, None].expand_as(counts)
    return torch.stack([log_relative(moments), 0.3 * counts.log1p().float(), 0.1 * paths.float()], 1)


class LearnedPrior:
    """The expected second moments in one scene, for `GuideCache.prior`.

    Args:
        theta: the network's.
        survey: of the scene.
    """

    def __init__(self, theta: Params, survey: SurveyFeatures) -> None:
        self.theta, self.survey = theta, survey

    @torch.no_grad()
    def __call__(self, squares: Tensor, counts: Tensor, voxels: Tensor) -> Tensor:
        """Second moments of the arguments of `second_moments`; the network's where the survey has features."""
        moments = second_moments(squares, counts, voxels)
        known, rows = self.survey.lookup(voxels)
        found = histogram_features(squares[known], counts[known], moments[known])
        features = torch.cat([self.survey.features[rows], found], 1)
        # with channels last it is twice as fast
        share = logits(self.theta, features.contiguous(memory_format=torch.channels_last)).double().softmax(1)
        moments[known] = (share ** (1 / POWER)).reshape(-1, SIDE, SIDE)
        return moments
