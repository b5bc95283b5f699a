"""The statistics by which exemplars are described, and the distance of pictures from them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from torch import Tensor

from metapp.appearance.features import moments
from metapp.apps.exemplar.octaves import Crop, Octaves
from metapp.learning.task import Batch, Tasks


@dataclass(frozen=True)
class Statistics(ABC):
    """Statistics of features that describe exemplars, octave by octave, and the distance of pictures from them.

    Attributes:
        octaves: the sizes of pictures, and the features of each.
        statistic_names: the names of what describes a map of features: "gram" for `gram0`, `gram1` and so on.
        reduced_precision: whether fits compute features in reduced precision.
    """

    octaves: Octaves
    statistic_names: ClassVar[tuple[str, ...]] = ("gram",)
    reduced_precision: ClassVar[bool] = False

    @abstractmethod
    def describe(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Compute all that fits and General's encoder need of exemplars, except quilts.

        Args:
            exemplars: pictures [B, 3, h, w] of the size of an octave, sRGB in [0, 1].
            octave: the octave, 0 for the whole size.

        Returns:
            The statistics of each map of features, such as `gram0`, named by `statistic_names`; `summary` [B, S].
        """

    def summarise(self, maps: list[Tensor], octave: int) -> Tensor:
        """Return the encoder's input [B, S]: means and root mean squares of features of an octave and coarser ones."""
        return moments(self.octaves.repeat_finest(maps, octave))

    @property
    def summary_size(self) -> int:
        """The length of the encoder's input, S."""
        return 2 * self.octaves.feature_channels

    def compute_features(self, pictures: Tensor, octave: int, crop: Crop | None = None) -> list[Tensor]:
        """Compute features [B, C, H', W'] of pictures [B, 3, H, W] of an octave's size, in the precision of fits."""
        return self.octaves.compute_features(pictures, octave, crop=crop, reduced=self.reduced_precision)

    def render_prediction(self, prediction: Any, described: Batch) -> Tensor:
        """Render what `errors` takes under the light of the exemplars described: pictures [T, B, 3, H, W]."""
        pictures: Tensor = prediction
        return pictures

    def even_light(self, pictures: Tensor, described: Batch) -> Tensor:
        """Remove the shading of the exemplars' light from pictures [B, 3, H, W]; here there is none."""
        return pictures

    def find_unusable(self, pictures: Tensor, described: Batch) -> Sequence[Tensor | None]:
        """Return the px of each picture [B, 3, H, W] that say little of the material, bool [H, W]; here None each."""
        return [None] * len(pictures)

    @abstractmethod
    def errors(self, prediction: Any, tasks: Tasks) -> dict[str, Tensor]:
        """Return error measures [T], by name, of pictures or maps [T, B, ...] against the exemplars of tasks."""
