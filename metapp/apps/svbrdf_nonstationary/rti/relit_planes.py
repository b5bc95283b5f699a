"""Few pictures of which photographs under any lamp are weighted sums: for files and pages that relight an object."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from metapp.apps.svbrdf_nonstationary.rti.light_process import (
    LightProcess,
    choose_process,
    mix_photos,
    sample_pixels,
)


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


def make_relit_planes(photos: Tensor, lamps: Tensor, count: int) -> RelitPlanes:
    """Return the `count` planes by which photographs are best approximated, at most one for each photograph.

    Args:
        photos: photographs, sRGB uint8 [N, 3, H, W].
        lamps: unit vectors towards their lamps, [N, 3].
        count: the number of planes.
    """
    sample = sample_pixels(photos).double()
    components = torch.linalg.eigh(sample @ sample.T).eigenvectors.flip(1)[:, :count].float()
    return RelitPlanes(mix_photos(components.T, photos), components, lamps, choose_process(photos, lamps))
