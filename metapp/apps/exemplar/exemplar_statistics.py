"""What is known of exemplars, and how far pictures are from it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

from torch import Tensor

from metapp.appearance.features import detail_difference, detail_statistics, moments
from metapp.apps.exemplar.octaves import Crop, Octaves
from metapp.learning.task import Batch, Tasks

SOFTNESS_WEIGHT = 0.2  # weight in the loss of how far the finest detail is from the exemplar's


@dataclass(frozen=True)
class Statistics(ABC):
    """Statistics of features that describe exemplars, octave by octave, and the distance of pictures from them.

    Attributes:
        octaves: the sizes of pictures, and the features of each.
        names: of what is known of each map of features: `gram0`, `gram1`, ... by "gram".
        reduced: whether fits see features in reduced precision.
    """

    octaves: Octaves
    names: ClassVar[tuple[str, ...]] = ("gram",)
    reduced: ClassVar[bool] = False

    @abstractmethod
    def describe(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Return all that fitting and encoding need of exemplars of the size of an octave, without layouts.

        Args:
            exemplars: [B, 3, h, w], sRGB in [0, 1].
            octave: 0 for the whole size.

        Returns:
            The statistics `names` of each map, such as `gram0`, and `summary` [B, S].
        """

    def summarise(self, maps: list[Tensor], octave: int) -> Tensor:
        """Return the encoder's input [B, S] from maps of an octave and coarser ones: means, root mean squares."""
        return moments(self.octaves.fill(maps, octave))

    @property
    def summary_size(self) -> int:
        """S, the length of the encoder's input."""
        return 2 * self.octaves.channels

    def compute_features(self, pictures: Tensor, octave: int, crop: Crop | None = None) -> list[Tensor]:
        """Compute features [B, C, H', W'] of pictures [B, 3, H, W] of an octave's size, in the precision of fits."""
        return self.octaves.compute_features(pictures, octave, crop=crop, reduced=self.reduced)

    def look(self, answer: Any, described: Batch) -> Tensor:
        """Return the pictures [T, B, 3, H, W] of an answer, as `errors` takes it, under the light of its exemplars."""
        pictures: Tensor = answer
        return pictures

    def evenly_lit(self, pictures: Tensor, described: Batch) -> Tensor:
        """Return pictures [B, 3, H, W] as if their exemplars' light were the same everywhere; here as they are."""
        return pictures

    def softness(self, pictures: Tensor, batch: Batch) -> Tensor:
        """Return part of a loss [T]: how far the detail of pictures [T, B, 3, H, W] is from the exemplars'.

        It is 0 of pictures of coarser octaves, and if the batch has no `detail_statistics`, as for networks that read no layout.
        """
        if "detail" not in batch or self.octaves.find_octave(batch):
            return pictures.new_zeros(len(pictures))
        return SOFTNESS_WEIGHT * detail_difference(detail_statistics(pictures), batch["detail"][:, None]).mean(1)

    @abstractmethod
    def errors(self, answer: Any, tasks: Tasks) -> dict[str, Tensor]:
        """Return measures [T] of how far pictures or maps [T, B, ...] are from the exemplars."""
