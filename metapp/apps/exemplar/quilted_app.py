"""The base of applications whose networks change quilts of exemplars: pictures of pieces that tile.

Which quilt a fit begins with is chosen in `quilts`. At the size of files its pieces are fetched from the photograph.
Noise says how far a tile is moved, and nothing else unless the network reads noise, too.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.lattice import remove_quadratic_trend
from metapp.apps.exemplar.app import ExemplarApp, Quilts
from metapp.apps.exemplar.quilts import choose_quilt, resize_tile
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec
from metapp.networks.quilted import fetch_pieces

LARGEST_PHOTO_PX = 4096  # side at which photographs are read, of which pieces are fetched
QUILT_KEYS = ("places", "quilt")  # parameters of fits that the exemplar determines and no step changes


@dataclass(frozen=True)
class QuiltedExemplarApp(ExemplarApp):
    """A network that changes a quilt of the exemplar.

    Fits have two parameters that the exemplar determines: `places` [T, 2, rows, columns], where in it each cell of the
    quilt comes from, and `quilt` [T, 3, H, W], its picture.

    Attributes:
        candidates: the number of quilts of which a fit begins with the best one; 0 for tasks without quilts.
    """

    candidates: int = 12

    def __post_init__(self) -> None:
        # places are in sides of the exemplar, and are applied to the whole square photograph
        if self.octaves.height != self.octaves.width:
            size = f"{self.octaves.height}x{self.octaves.width}"
            raise ValueError(f"{self.name}: exemplars of {size}, expected square ones for quilts.")

    @property
    @override
    def read_size(self) -> int:
        return LARGEST_PHOTO_PX

    @override
    def without_quilts(self) -> QuiltedExemplarApp:
        return replace(self, candidates=0)

    @override
    def find_quilts(self, theta: Params) -> Quilts:
        return Quilts(theta["quilt"], theta["places"])

    @property
    @override
    def file_side_step(self) -> int:
        """1, as quilts are quilted again for files of any size."""
        return 1

    @property
    def cells(self) -> tuple[int, int]:
        """The rows and columns of cells of a quilt: the px of exemplars in training."""
        return self.octaves.octave_size()

    @override
    def make_targets(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Add `places` and `quilt`, the best of `candidates` quilts of each exemplar."""
        targets = super().make_targets(exemplars, octave)
        if not self.candidates:
            return targets
        unshaded = self.statistics.even_light(exemplars, targets)
        avoided_px = self.statistics.find_unusable(exemplars, targets)
        quilts = [
            choose_quilt(
                picture, remove_quadratic_trend(picture), self.cells, self.statistics, self.candidates, avoided
            )
            for picture, avoided in zip(unshaded, avoided_px, strict=True)
        ]
        parts = (torch.stack(tensors) for tensors in zip(*quilts, strict=True))
        return targets | dict(zip(QUILT_KEYS, parts, strict=True))

    @override
    def make_variant_targets(self, exemplars: Tensor, octave: int) -> dict[str, Tensor]:
        """Quilt each augmented exemplar once."""
        return replace(self, candidates=1).make_targets(exemplars, octave)

    @override
    def encoder_input(self, tasks: Tasks, rng: Generator) -> Batch:
        return super().encoder_input(tasks, rng) | self.task_parameters(tasks)

    @override
    def select_known(self, encoder_input: Batch) -> Params:
        return {key: encoder_input[key] for key in QUILT_KEYS}

    @override
    def task_parameters(self, tasks: Tasks) -> Params:
        """Return the quilts."""
        return tasks.gather(QUILT_KEYS)

    @property
    @override
    def task_parameter_specs(self) -> Mapping[str, TensorSpec]:
        return {"places": TensorSpec((2, *self.cells)), "quilt": TensorSpec((3, *self.cells))}

    def take_even_photo(self, image: Tensor) -> Tensor:
        """Return a photograph as floats [3, S, S], display values in [0, 1], in even light; here as it is.

        Args:
            image: the photograph, uint8 [3, S, S].
        """
        return image.float() / 255

    def fetch_quilt(self, theta: Params, task: Task, subject: str) -> Tensor:
        """Fetch the quilt of a fit from its photograph, at the photograph's resolution.

        Args:
            theta: a fit, with a task axis of length 1.
            task: the task that was fitted. If it holds no photograph, the quilt is the one in the fit, and a warning
                says so.
            subject: begins the clause of the warning on the size, such as "the maps have".

        Returns:
            The quilt, display values [1, 3, H, W].
        """
        if "image" in task.data:
            photo = self.take_even_photo(task.data["image"])
            return fetch_pieces(photo, theta["places"][0], (photo.shape[1], photo.shape[2]), self.cells)[None]
        quilt = theta["quilt"]
        warnings.warn(
            f"{task.name}: its photo is not at hand, expected for the photo's resolution; {subject} "
            f"{quilt.shape[-1]} px a side. Give the photo, too, or fit it again.",
            stacklevel=2,
        )
        return quilt

    def resize_tile_of_fit(self, task: Task, layers: Tensor, colours: Tensor, size: tuple[int, int]) -> Tensor:
        """Make a tile of another size from pieces of a tile, and warn if that cuts regular structure of the photograph.

        Args:
            task: the task that was fitted; without a photograph in it there is no warning.
            layers, colours, size: the arguments of :func:`metapp.apps.exemplar.quilts.resize_tile`.

        Returns:
            [C, *size].
        """
        resized = resize_tile(layers, colours, size)
        if "image" in task.data:
            resized.warn_of_lost_order(self.octaves.take_exemplar(task.data["image"][None].float() / 255)[0], task.name)
        return resized.layers
