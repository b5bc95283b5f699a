"""The prior of a guide cache: what a survey of a scene tells, read by a small network.

The light that comes to an entry from a direction is what the surface that is met there sends out. Paths estimate the
latter, one number for each entry; rays find which entry is met in which bin. So much is known of the shapes of a scene
long before paths have filled the histograms.

The network maps such pictures over the bins of one entry, [SIDE, SIDE] each, to how densely paths should be sampled
there. It knows nothing else of a scene. General trained it on rooms (checkpoints/README.md).
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import conv2d, silu

from metapp.extensions.guided.histogram import (
    AXES,
    BINS,
    DEFENSIVE,
    ENTRIES,
    GRID,
    POWER,
    SIDE,
    coarse_voxels,
    log_relative,
    second_moments,
    voxels_of,
)
from metapp.learning.task import Params
from metapp.networks.layers import add_layer
from metapp.storage.records import load_checkpoint

CHANNELS = ("arriving", "emitted", "distance", "cosine", "paths")
ENTRY_PRIOR_PATHS = 8.0  # that the entries around one count as

_HALF = GRID // 2
_COARSE_ENTRIES = _HALF**3 * AXES
_BRIGHTEST = 1e4  # luminance; more says no more


class SurveyFeatures(NamedTuple):
    """Features of entries in voxels of twice the side.

    Attributes:
        rows: of all these entries the row here, or -1.
        voxels: of the rows, as of `voxels_of`, [P, 4].
        features: float32 [P, len(CHANNELS), SIDE, SIDE]: log of the squared light that is expected to arrive; the part
            of it that comes from emitters; log(1 + distance); the cosine at the surface that is met; and of how many
            paths it is known what that sends out.
    """

    rows: Tensor
    voxels: Tensor
    features: Tensor

    @classmethod
    def of(cls, voxels: Tensor, features: Tensor) -> SurveyFeatures:
        """Features of so many entries, by the index of their voxels."""
        rows = torch.full((_COARSE_ENTRIES,), -1)
        rows[_index(voxels)] = torch.arange(len(voxels))
        return cls(rows, voxels, features)

    def lookup(self, voxels: Tensor) -> tuple[Tensor, Tensor]:
        """The index of those of such coarse voxels [P, 4] that were surveyed, [K], and their rows [K]."""
        row = self.rows[_index(voxels)]
        known = (row >= 0).nonzero()[:, 0]
        return known, row[known]


class FirstHits(NamedTuple):
    """The first surfaces that scatter on rays from entries, [P, rays of a bin, BINS] each.

    Attributes:
        entry: of the cache; ENTRIES where nothing was met.
        emitted: luminance of emitters that were met, by their MIS weight beside emitter sampling.
        distance: along the ray.
        cosine: at the surface.
    """

    entry: Tensor
    emitted: Tensor
    distance: Tensor
    cosine: Tensor


def features_of(hits: FirstHits, sums: Tensor, counts: Tensor) -> Tensor:
    """The features, of what entries send out: sums of luminance and counts of paths, float64 [ENTRIES] each."""
    outgoing, paths = (values.float() for values in _shrunk_means(sums, counts))
    emitted = hits.emitted.clamp(max=_BRIGHTEST)
    arriving = (outgoing[hits.entry] + emitted).square().mean(1)
    from_emitters = emitted.square().mean(1)
    part = from_emitters / (from_emitters + arriving.mean(1, keepdim=True) + 1e-12)
    distance, cosine = (values.mean(1) for values in (hits.distance, hits.cosine))
    known = 0.2 * paths[hits.entry].mean(1).log1p()
    arrives = log_relative(arriving.reshape(-1, SIDE, SIDE))
    others = (values.reshape(-1, SIDE, SIDE) for values in (part, distance.log1p(), cosine, known))
    return torch.stack([arrives, *others], 1)


def _shrunk_means(sums: Tensor, counts: Tensor) -> tuple[Tensor, Tensor]:
    """Means of entries, shrunk towards those of voxels of twice the side, and these towards that of all; and counts.

    Both with a last entry for where nothing is met.
    """
    parent = _index(coarse_voxels(voxels_of(torch.arange(ENTRIES))))
    total, count = (values.new_zeros(_COARSE_ENTRIES).index_add_(0, parent, values) for values in (sums, counts))
    mean = sums.sum() / counts.sum().clamp_min(1)
    around = (total + ENTRY_PRIOR_PATHS * mean) / (count + ENTRY_PRIOR_PATHS)
    outgoing = (sums + ENTRY_PRIOR_PATHS * around[parent]) / (counts + ENTRY_PRIOR_PATHS)
    return torch.cat([outgoing, mean[None]]), torch.cat([counts, counts.new_zeros(1)])


def _index(voxels: Tensor) -> Tensor:
    index = voxels[:, 0]
    for column, sides in ((1, _HALF), (2, _HALF), (3, AXES)):
        index = index * sides + voxels[:, column]
    return index


NAME = "guiding"
FEATURES = len(CHANNELS) + 3
HIDDEN = 16
_ESTIMATE = len(CHANNELS)  # the feature that holds the histogram's own estimate


def shipped() -> Path:
    """The checkpoint that ships."""
    return Path(str(resources.files("metapp.extensions.guided"))) / "checkpoints" / "general.safetensors"


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
    """Densities of directions by features [P, FEATURES, SIDE, SIDE] of any entries.

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
    """Features of the arguments of `second_moments` and its result, [P, SIDE, SIDE] each.

    Returns:
        [P, 3, SIDE, SIDE]: the moments' logarithms, how many paths a bin had, how many the entry.
    """
    paths = counts.flatten(1).sum(1).log1p()[:, None, None].expand_as(counts)
    return torch.stack([log_relative(moments), 0.3 * counts.log1p().float(), 0.1 * paths.float()], 1)


class LearnedPrior:
    """The expected second moments in a scene that was surveyed, for `GuideCache.prior`."""

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
