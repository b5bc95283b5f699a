"""Few pictures of which photographs under any lamp are weighted sums: for files and pages that relight an object."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from metapp.apps.svbrdf_nonstationary.rti.light_process import (
    LightProcess,
    mix_photos,
    sample_pixels,
)
from metapp.apps.svbrdf_nonstationary.rti.lit_photos import LitPhotos


class RelitPlanes(NamedTuple):
    """Planes, pictures of which photographs under any lamp are weighted sums, and what their weights follow from.

    Attributes:
        planes: principal components of the photographs' display values, without their mean taken away, [K, 3, H, W]:
            of any sign, of falling size.
        mixture: the weight of each plane in each of the N photographs, [N, K].
        lamps: unit vectors towards the lamps of the photographs, [N, 3].
        process: predicts photographs under other lamps.
    """

    planes: Tensor
    mixture: Tensor
    lamps: Tensor
    process: LightProcess

    def weights(self, directions: Tensor) -> Tensor:
        """Return the weights of the planes in pictures under lamps in M directions, unit vectors [M, 3]: [M, K].

        The picture under lamp m has the display values sum_k weights[m, k] planes[k], to be clamped to 0 to 1.
        """
        return self.process.interpolation(directions, self.lamps) @ self.mixture


def make_relit_planes(lit_photos: LitPhotos, count: int) -> RelitPlanes:
    """Return the `count` planes by which photographs are best approximated, at most one for each photograph."""
    photos = lit_photos.photos
    sample = sample_pixels(photos).double()
    components = torch.linalg.eigh(sample @ sample.T).eigenvectors.flip(1)[:, :count].float()
    return RelitPlanes(mix_photos(components.T, photos), components, lit_photos.lamps, lit_photos.process)
