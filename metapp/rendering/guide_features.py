"""What a survey of a scene tells about each entry of the cache: features over the bins of directions.

The light that comes to an entry from a direction is what the surface that is met there sends out. Paths estimate the
latter, one number for each entry; rays find which entry is met in which bin. So much is known of the shapes of a scene
long before paths have filled the histograms.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from metapp.rendering.guide_histogram import AXES, ENTRIES, GRID, SIDE, coarse_voxels, log_relative, voxels_of

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
        """Which of such voxels were surveyed, as an index into them [K], and their rows [K].

        Args:
            voxels: of twice the side, as of `voxels_of`, [P, 4].
        """
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
