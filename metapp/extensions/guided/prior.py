"""The prior of a guide cache: a survey of a scene, read by a small network.

The light that comes to an entry from a direction is the radiance of the surface that is met there. Paths estimate the
latter, one number for each entry; rays find which entry is met in which bin. So much is known of the shapes of a scene
long before paths have filled the histograms.

The network maps such pictures over the bins of one entry, [SIDE, SIDE] each, to how densely paths should be sampled
there. It knows nothing else of a scene. General trained it on rooms (checkpoints/README.md).
"""

from __future__ import annotations

import functools
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import conv2d, silu

from metapp.extensions.guided.histogram import (
    CACHE_ENTRIES,
    GRID_SIDE_VOXELS,
    HISTOGRAM_SIDE_BINS,
    NORMAL_AXES,
    SECOND_MOMENT_POWER,
    coarse_voxels,
    log_relative,
    second_moments,
    voxels_of_entries,
)
from metapp.learning.task import Params
from metapp.storage.checkpoint_files import load_checkpoint

SURVEY_CHANNELS = ("arriving", "emitted", "distance", "cosine", "paths")
ENTRY_PRIOR_PATHS = 8.0  # that the entries around one count as

_HALF = GRID_SIDE_VOXELS // 2
_COARSE_ENTRIES = _HALF**3 * NORMAL_AXES
_BRIGHTEST = 1e4  # luminance; more says no more


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


def entry_features(hits: FirstHits, sums: Tensor, counts: Tensor) -> Tensor:
    """Features of entries in voxels of twice the side.

    Args:
        hits: of rays from them.
        sums, counts: radiance of entries, sums of luminance and counts of paths, float64 [ENTRIES] each.

    Returns:
        float32 [P, len(CHANNELS), SIDE, SIDE]: log of the squared light that is expected to arrive; the part of it that
        comes from emitters; log(1 + distance); the cosine at the surface that is met; and of how many paths it is known
        its radiance.
    """
    outgoing, paths = (values.float() for values in _shrunk_means(sums, counts))
    emitted = hits.emitted.clamp(max=_BRIGHTEST)
    arriving = (outgoing[hits.entry] + emitted).square().mean(1)
    from_emitters = emitted.square().mean(1)
    part = from_emitters / (from_emitters + arriving.mean(1, keepdim=True) + 1e-12)
    distance, cosine = (values.mean(1) for values in (hits.distance, hits.cosine))
    known = 0.2 * paths[hits.entry].mean(1).log1p()
    arrives = log_relative(arriving.reshape(-1, HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS))
    others = (
        values.reshape(-1, HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS)
        for values in (part, distance.log1p(), cosine, known)
    )
    return torch.stack([arrives, *others], 1)


def _shrunk_means(sums: Tensor, counts: Tensor) -> tuple[Tensor, Tensor]:
    """Means of entries, shrunk towards those of voxels of twice the side, and these towards that of all; and counts.

    Both with a last entry for where nothing is met.
    """
    parent = _index(coarse_voxels(voxels_of_entries(torch.arange(CACHE_ENTRIES))))
    total, count = (values.new_zeros(_COARSE_ENTRIES).index_add_(0, parent, values) for values in (sums, counts))
    mean = sums.sum() / counts.sum().clamp_min(1)
    around = (total + ENTRY_PRIOR_PATHS * mean) / (count + ENTRY_PRIOR_PATHS)
    outgoing = (sums + ENTRY_PRIOR_PATHS * around[parent]) / (counts + ENTRY_PRIOR_PATHS)
    return torch.cat([outgoing, mean[None]]), torch.cat([counts, counts.new_zeros(1)])


def _index(voxels: Tensor) -> Tensor:
    index = voxels[:, 0]
    for column, sides in ((1, _HALF), (2, _HALF), (3, NORMAL_AXES)):
        index = index * sides + voxels[:, column]
    return index


@functools.cache
def read_prior() -> Params:
    """The parameters of the network that ships."""
    file = Path(str(resources.files("metapp.extensions.guided"))) / "checkpoints" / "general.safetensors"
    return load_checkpoint(file)[0].encoder


def predict_log_densities(theta: Params, features: Tensor) -> Tensor:
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
    """The expected second moments in a scene that was surveyed, for `GuideCache.prior`.

    Args:
        theta: the network's parameters.
        voxels: that were surveyed, of twice the side, as of `voxels_of_entries`, [S, 4].
        features: of these, as of `entry_features`.
    """

    def __init__(self, theta: Params, voxels: Tensor, features: Tensor) -> None:
        self.theta, self.features = theta, features
        self.rows = torch.full((_COARSE_ENTRIES,), -1)  # of all such voxels the row of features, or none
        self.rows[_index(voxels)] = torch.arange(len(voxels))

    @torch.no_grad()
    def __call__(self, squares: Tensor, counts: Tensor, voxels: Tensor) -> Tensor:
        """Second moments of the arguments of `second_moments`; the network's where the survey has features."""
        moments = second_moments(squares, counts, voxels)
        row = self.rows[_index(voxels)]
        known = (row >= 0).nonzero()[:, 0]
        found = histogram_features(squares[known], counts[known], moments[known])
        features = torch.cat([self.features[row[known]], found], 1)
        # with channels last it is twice as fast
        share = (
            predict_log_densities(self.theta, features.contiguous(memory_format=torch.channels_last))
            .double()
            .softmax(1)
        )
        moments[known] = (share ** (1 / SECOND_MOMENT_POWER)).reshape(-1, HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS)
        return moments
