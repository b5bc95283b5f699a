"""The prior of a guide cache: a survey of a scene, read by a small network.

The light that comes to an entry from a direction is the radiance of the surface that is met there. Paths estimate this
radiance, one number for each entry; rays find which entry is met in which bin. So much is known of the shapes of a
scene long before paths have filled the histograms.

The network maps such pictures over the bins of one entry, [SIDE, SIDE] each, to how densely paths should be sampled
there; SIDE is HISTOGRAM_SIDE_BINS. It knows nothing else of a scene. General trained it on rooms
(checkpoints/README.md).
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
from metapp.storage.checkpoint_files import read_entry

SURVEY_CHANNELS = ("arriving", "emitted", "distance", "cosine", "paths")
ENTRY_PRIOR_PATHS = 8.0  # the mean of the entries around an entry counts as so many paths

_COARSE_SIDE = GRID_SIDE_VOXELS // 2  # voxels of twice the side along an axis
_COARSE_ENTRIES = _COARSE_SIDE**3 * NORMAL_AXES
_MAX_LUMINANCE = 1e4  # of emitters: brighter ones are as dominant


class FirstHits(NamedTuple):
    """The first scattering surfaces on rays from entries, [P, rays of a bin, HISTOGRAM_BINS] each.

    Attributes:
        entry: the entry of the cache; CACHE_ENTRIES where nothing was met.
        emitted: the luminance of emitters that were met, by their MIS weight beside emitter sampling.
        distance: the distance along the ray.
        cosine: the cosine at the surface.
    """

    entry: Tensor
    emitted: Tensor
    distance: Tensor
    cosine: Tensor


def entry_features(hits: FirstHits, sums: Tensor, counts: Tensor) -> Tensor:
    """Return what the survey knows of entries in voxels of twice the side, as pictures over their bins.

    Args:
        hits: the first hits of rays from these entries.
        sums: the sums of luminance of all entries, float64 [CACHE_ENTRIES].
        counts: the counts of paths of all entries, float64 [CACHE_ENTRIES].

    Returns:
        float32 [P, len(SURVEY_CHANNELS), SIDE, SIDE]: the logarithm of the squared light that is expected to arrive;
        the part of it that comes from emitters; log(1 + distance); the cosine at the surface that is met; by how many
        paths the radiance of that surface is known.
    """
    outgoing, paths = (values.float() for values in _shrink_means(sums, counts))
    emitted = hits.emitted.clamp(max=_MAX_LUMINANCE)
    arriving = (outgoing[hits.entry] + emitted).square().mean(1)
    from_emitters = emitted.square().mean(1)
    emitter_share = from_emitters / (from_emitters + arriving.mean(1, keepdim=True) + 1e-12)
    distance, cosine = (values.mean(1) for values in (hits.distance, hits.cosine))
    path_counts = 0.2 * paths[hits.entry].mean(1).log1p()
    log_arriving = log_relative(arriving.reshape(-1, HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS))
    other_channels = (
        values.reshape(-1, HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS)
        for values in (emitter_share, distance.log1p(), cosine, path_counts)
    )
    return torch.stack([log_arriving, *other_channels], 1)


def _shrink_means(sums: Tensor, counts: Tensor) -> tuple[Tensor, Tensor]:
    """Return the mean radiance of entries, shrunk towards the means of coarser voxels, and the counts of paths.

    The means of voxels of twice the side are in turn shrunk towards the mean of all. Both results have a last entry for
    rays that meet nothing.

    Args:
        sums: the sums of luminance of all entries, [CACHE_ENTRIES].
        counts: the counts of paths of all entries, [CACHE_ENTRIES].
    """
    coarse_index = _index_voxels(coarse_voxels(voxels_of_entries(torch.arange(CACHE_ENTRIES))))
    coarse_sums, coarse_counts = (
        values.new_zeros(_COARSE_ENTRIES).index_add_(0, coarse_index, values) for values in (sums, counts)
    )
    mean = sums.sum() / counts.sum().clamp_min(1)
    coarse_means = (coarse_sums + ENTRY_PRIOR_PATHS * mean) / (coarse_counts + ENTRY_PRIOR_PATHS)
    outgoing = (sums + ENTRY_PRIOR_PATHS * coarse_means[coarse_index]) / (counts + ENTRY_PRIOR_PATHS)
    return torch.cat([outgoing, mean[None]]), torch.cat([counts, counts.new_zeros(1)])


def _index_voxels(voxels: Tensor) -> Tensor:
    """Return the numbers [P] of voxels of twice the side with their axes, [P, 4]."""
    index = voxels[:, 0]
    for column, sides in ((1, _COARSE_SIDE), (2, _COARSE_SIDE), (3, NORMAL_AXES)):
        index = index * sides + voxels[:, column]
    return index


@functools.cache
def read_prior() -> Params:
    """Read the parameters of the network that ships."""
    file = Path(str(resources.files("metapp.extensions.guided"))) / "checkpoints" / "general.safetensors"
    return read_entry(file, "general")[0].encoder


def predict_log_densities(theta: Params, features: Tensor) -> Tensor:
    """Predict the logarithms of the densities of bins, [P, HISTOGRAM_BINS], up to a constant for each entry.

    Args:
        theta: the network's parameters.
        features: the channels of :func:`entry_features`, then of :func:`histogram_features`, [P, C, SIDE, SIDE].
    """
    first = silu(conv2d(features, theta["first.kernel"], theta["first.shift"], padding=1))
    second = silu(conv2d(first, theta["second.kernel"], theta["second.shift"], padding=1) + first)
    return (conv2d(second, theta["out.kernel"]) + conv2d(features, theta["past.kernel"])).flatten(1)


def histogram_features(squares: Tensor, counts: Tensor, moments: Tensor) -> Tensor:
    """Return what paths have told of entries so far, as pictures over their bins.

    Args:
        squares: the sums of squared radiance that :func:`second_moments` takes, [P, SIDE, SIDE].
        counts: the sums of ones that :func:`second_moments` takes, [P, SIDE, SIDE].
        moments: the second moments that it returns, [P, SIDE, SIDE].

    Returns:
        [P, 3, SIDE, SIDE]: the logarithms of the moments, how many paths the bin had, and how many the entry.
    """
    paths = counts.flatten(1).sum(1).log1p()[:, None, None].expand_as(counts)
    return torch.stack([log_relative(moments), 0.3 * counts.log1p().float(), 0.1 * paths.float()], 1)


class LearnedPrior:
    """The expected second moments in a scene that was surveyed, for `GuideCache.prior`.

    Args:
        theta: the network's parameters.
        voxels: the voxels of twice the side that were surveyed, with their axes, [S, 4].
        features: the features of these voxels that :func:`entry_features` returns.

    Attributes:
        rows: for each voxel of twice the side its row of `features`; -1 if it was not surveyed.
    """

    def __init__(self, theta: Params, voxels: Tensor, features: Tensor) -> None:
        self.theta, self.features = theta, features
        self.rows = torch.full((_COARSE_ENTRIES,), -1)  # for each coarse voxel its row of features, or -1
        self.rows[_index_voxels(voxels)] = torch.arange(len(voxels))

    @torch.no_grad()
    def __call__(self, squares: Tensor, counts: Tensor, voxels: Tensor) -> Tensor:
        """Return the second moments [P, SIDE, SIDE] that are expected: the network's where the survey has features.

        Elsewhere they are what :func:`second_moments` returns for these arguments.
        """
        moments = second_moments(squares, counts, voxels)
        feature_rows = self.rows[_index_voxels(voxels)]
        surveyed = (feature_rows >= 0).nonzero()[:, 0]
        path_features = histogram_features(squares[surveyed], counts[surveyed], moments[surveyed])
        features = torch.cat([self.features[feature_rows[surveyed]], path_features], 1)
        # the network is twice as fast with channels last
        share = (
            predict_log_densities(self.theta, features.contiguous(memory_format=torch.channels_last))
            .double()
            .softmax(1)
        )
        moments[surveyed] = (share ** (1 / SECOND_MOMENT_POWER)).reshape(-1, HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS)
        return moments
