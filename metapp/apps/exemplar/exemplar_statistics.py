"""The statistics of exemplars, which pictures are compared with in fits, in training and in errors."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.features import moments
from metapp.apps.exemplar.octaves import Crop, Octaves
from metapp.learning.components import Judge
from metapp.learning.task import Batch, Task, Tasks


@dataclass(frozen=True)
class Statistics(Judge[Any, Batch, Batch]):
    """Statistics of features that describe exemplars, octave by octave, and the judge of pictures by them.

    What fits see is judged, too: tasks hold no truth beside that, unless a subclass says so.

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

    @abstractmethod
    def targets(self, tasks: Tasks, rng: Generator | None = None) -> Batch:
        """Return what pictures are compared with, by name, [T, ...] each.

        Args:
            tasks: exemplars.
            rng: draws a part of it, as a step of a fit sees; None for all of it.
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
    def take_even_photo(self, image: Tensor) -> Tensor:
        """Return a photograph without its light, display values [3, S, S] in [0, 1], of which pieces are fetched.

        Args:
            image: the photograph, uint8 [3, S, S].
        """

    @abstractmethod
    def loss(self, answer: Any, described: Batch) -> Tensor:
        """Compute the loss of fits, [T].

        Args:
            answer: what the decoder returns.
            described: what :meth:`targets` returns.
        """

    @override
    def prepare(self, task: Task, decoder: Any) -> Batch:
        return {}

    @override
    def gather(self, tasks: Tasks) -> Batch:
        return {}

    @override
    def read(self, batch: Batch) -> Batch:
        return batch

    @override
    def outer_loss(self, answer: Any, seen: Batch, truth: Batch) -> Tensor:
        return self.loss(answer, seen)

    def vary_truth(self, tasks: Tasks, is_flipped: Tensor, is_transposed: Tensor, channels: Tensor) -> Batch:
        """Return the truth [T, ...] of exemplars whose pictures data augmentation changes; here there is none.

        Args:
            tasks: the exemplars before that.
            is_flipped: whether left and right are exchanged, bool [T].
            is_transposed: whether rows and columns are exchanged after that, bool [T].
            channels: the number that each channel had before, [T, 3].
        """
        return {}


def gather_known(tasks: Tasks, *names: str) -> Batch:
    """Return the tensors of some names, [T, ...], that the tasks have; see :meth:`Tasks.gather`."""
    return tasks.gather([name for name in names if name in tasks.data])


def turn_picture(picture: Tensor, is_flipped: bool, is_transposed: bool) -> Tensor:
    """Flip a picture [..., H, W] from left to right, then exchange rows and columns, each if that is asked for."""
    picture = picture.flip(-1) if is_flipped else picture
    return picture.mT if is_transposed else picture
