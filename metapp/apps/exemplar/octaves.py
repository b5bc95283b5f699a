"""Octaves: the sizes at which pictures are compared with an exemplar, and the features that are compared at each.

The module knows pictures and features of VGG-16. What is computed of these features is decided in
:mod:`metapp.apps.exemplar.exemplar_statistics`; the finest octave of data is told by the number of Gram matrices.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

from metapp.appearance.features import load_features, tap_channels

Crop = Callable[[Tensor], Tensor]  # takes a part of pictures [B, 3, H, W]
Item = TypeVar("Item")


@dataclass(frozen=True)
class Octaves:
    """The sizes at which pictures are compared with an exemplar, each half of the one before (Snelgrove 2017).

    Octaves are counted from 0, the finest. Lists of feature maps go from the coarsest octave to the finest. Each finer
    octave leaves out the deepest layer of the one below, so that deep layers see large structures at little cost.

    Attributes:
        height, width: the size of exemplars, and of pictures that are compared with them, in texels.
        taps: the layers of VGG-16 whose statistics are compared; the coarsest octave has all of them.
        count: the number of octaves.
        shares: the shares of a descent's steps up to which it sees the coarsest octave alone, the two coarsest, and so
            on; () if it sees all from the beginning.

    >>> octaves = Octaves(64, 96, ("relu1_1", "relu2_1", "relu3_1"), count=2)
    >>> octaves.octave_size(1), octaves.count_maps(1), octaves.count_maps(0)
    ((32, 48), 3, 5)
    """

    height: int
    width: int
    taps: tuple[str, ...]
    count: int = 1
    shares: tuple[float, ...] = ()

    def octave_size(self, octave: int = 0) -> tuple[int, int]:
        """Return the height and width, in texels, of pictures of an octave."""
        return self.height >> octave, self.width >> octave

    def count_maps(self, octave: int) -> int:
        """Count the feature maps of an octave and all coarser ones."""
        return sum(map(self._count_taps, range(octave, self.count)))

    def find_octave(self, data: Mapping[str, Tensor]) -> int:
        """Return the finest octave that data describe, which hold `gram0`, `gram1` and so on for its feature maps."""
        counts = [self.count_maps(octave) for octave in range(self.count)]
        return counts.index(sum(key.startswith("gram") for key in data))

    def compute_features(
        self, images: Tensor, octave: int = 0, *, crop: Crop | None = None, reduced: bool = False
    ) -> list[Tensor]:
        """Compute the feature maps [B, C, H', W'] of images at an octave and at all coarser ones, the coarsest first.

        Args:
            images: pictures [B, 3, H, W] of the size of the octave, sRGB in [0, 1].
            octave: the octave, 0 for the whole size.
            crop: takes a part of images; octave 0, whose features take the longest, is computed of that part alone.
            reduced: whether precision is reduced where a descent needs features; see
                :class:`metapp.appearance.features.FeatureExtractor`.
        """
        features, maps = load_features(self.taps, images), []
        for coarser in reversed(range(octave, self.count)):
            factor = 2 ** (coarser - octave)
            octave_images = avg_pool2d(images, factor) if factor > 1 else images
            octave_images = crop(octave_images) if crop and coarser == 0 else octave_images
            maps += features(octave_images, self._count_taps(coarser), reduced=reduced)
        return maps

    def repeat_finest(self, maps: list[Item], octave: int) -> list[Item]:
        """Complete a list of items, one for each feature map of an octave and coarser ones, to one of octave 0.

        Items of the finest octave stand for all finer ones.
        """
        finest_maps = maps[self.count_maps(octave + 1) :]
        return maps + [item for finer in reversed(range(octave)) for item in finest_maps[: self._count_taps(finer)]]

    @property
    def feature_channels(self) -> int:
        """The number of channels of all feature maps together."""
        channels = tap_channels(self.taps)
        return sum(sum(channels[: self._count_taps(octave)]) for octave in range(self.count))

    def take_exemplar(self, images: Tensor, octave: int = 0) -> Tensor:
        """Crop square images [B, 3, S, S] to the proportions of exemplars, and resample them to an octave's size."""
        rows = round(images.shape[-1] * self.height / self.width)
        top = (images.shape[-2] - rows) // 2
        size, part = self.octave_size(octave), images[..., top : top + rows, :]
        return interpolate(part, size=size, mode="area" if part.shape[-2] >= size[0] else "bilinear")

    def _count_taps(self, octave: int) -> int:
        """Count the layers that are compared at an octave."""
        return len(self.taps) - (self.count - 1 - octave)
