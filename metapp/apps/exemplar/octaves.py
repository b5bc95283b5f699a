"""Octaves: the sizes at which pictures are compared with an exemplar, and the features that are compared at each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

from metapp.appearance.features import load_features, tap_channels

Crop = Callable[[Tensor], Tensor]
Item = TypeVar("Item")


@dataclass(frozen=True)
class Octaves:
    """The sizes at which pictures are compared with an exemplar, each half of the one before (Snelgrove 2017).

    An octave is counted from 0, the finest. What describes several is in order from the coarsest to the finest, one
    item for each map of features: each finer octave leaves out the deepest layer of the one below, so that deep layers
    see large structures at little cost.

    Attributes:
        height, width: texels of the exemplar and of generated pictures in training.
        taps: the layers of VGG-16 whose statistics are compared, at the coarsest octave all of them.
        count: the number of octaves.
        shares: of its steps up to which a descent sees the coarsest octave alone, the two coarsest, and so on; () if
            it sees all from the beginning. A `Pyramid` makes small pictures, too.
        finer: octaves by which exemplars are finer than those of training; layouts, which hold the
            structures that are larger in texels then, stay as they are.

    >>> octaves = Octaves(64, 96, ("relu1_1", "relu2_1", "relu3_1"), count=2)
    >>> octaves.size(1), octaves.count_maps(1), octaves.count_maps(0)
    ((32, 48), 3, 5)
    """

    height: int
    width: int
    taps: tuple[str, ...]
    count: int = 1
    shares: tuple[float, ...] = ()
    finer: int = 0

    def size(self, octave: int = 0) -> tuple[int, int]:
        """Return height and width of the pictures of an octave in texels."""
        return self.height >> octave, self.width >> octave

    @property
    def layout_size(self) -> tuple[int, int]:
        """Height and width of layouts: twice those of the coarsest pictures in training, if there are finer ones."""
        return self.size(max(0, self.count - 2) + self.finer)

    def layout_ratio(self, octave: int = 0) -> float:
        """Return the ratio of the sides of an octave's pictures to those of their layouts."""
        return self.size(octave)[0] / self.layout_size[0]

    def count_maps(self, octave: int) -> int:
        """Count the maps of features from an octave to the coarsest."""
        return sum(map(self._taps_of, range(octave, self.count)))

    def find_octave(self, data: Mapping[str, Tensor]) -> int:
        """Return the finest octave that data describe, which hold `gram0`, `gram1` ..., one a map of features."""
        counts = [self.count_maps(octave) for octave in range(self.count)]
        return counts.index(sum(key.startswith("gram") for key in data))

    def compute_features(
        self, images: Tensor, octave: int = 0, *, crop: Crop | None = None, reduced: bool = False
    ) -> list[Tensor]:
        """Compute features [B, C, H', W'] of images [B, 3, H, W] of the size of an octave, in it and all coarser ones.

        Args:
            images: sRGB in [0, 1].
            octave: 0 for the whole size.
            crop: takes the part of images whose features of the finest octave, which take the longest, are computed.
            reduced: in reduced precision where a descent needs them (`metapp.appearance.features.FeatureExtractor`).
        """
        features, maps = load_features(self.taps, images), []
        for coarser in reversed(range(octave, self.count)):
            times = 2 ** (coarser - octave)
            some = avg_pool2d(images, times) if times > 1 else images
            some = crop(some) if crop and coarser == 0 else some
            maps += features(some, self._taps_of(coarser), reduced=reduced)
        return maps

    def fill(self, maps: list[Item], octave: int) -> list[Item]:
        """Return as many maps as of octave 0 from those of an octave: the finest one stands for all that are finer."""
        finest = maps[self.count_maps(octave + 1) :]
        return maps + [each for finer in reversed(range(octave)) for each in finest[: self._taps_of(finer)]]

    @property
    def channels(self) -> int:
        """The number of channels of all maps of features."""
        channels = tap_channels(self.taps)
        return sum(sum(channels[: self._taps_of(octave)]) for octave in range(self.count))

    def take_exemplar(self, images: Tensor, octave: int = 0) -> Tensor:
        """Take the part of square images [B, 3, S, S] of these proportions, and resample it to an octave's size."""
        rows = round(images.shape[-1] * self.height / self.width)
        top = (images.shape[-2] - rows) // 2
        size, part = self.size(octave), images[..., top : top + rows, :]
        return interpolate(part, size=size, mode="area" if part.shape[-2] >= size[0] else "bilinear")

    def _taps_of(self, octave: int) -> int:
        """Return the number of layers that are compared at an octave."""
        return len(self.taps) - (self.count - 1 - octave)
