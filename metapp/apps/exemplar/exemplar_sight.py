"""The sight of an exemplar: its statistics, which pictures are compared with, and the quilt that a fit begins with.

Data augmentation, which varies exemplars, is here, too. What is compared is said by
:class:`metapp.apps.exemplar.exemplar_statistics.Statistics`.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.lattice import remove_quadratic_trend
from metapp.apps.exemplar.exemplar_codec import JUDGED_SEED, fixed_noise
from metapp.apps.exemplar.exemplar_statistics import Statistics, gather_known, turn_picture
from metapp.apps.exemplar.quilts import QUILT_NAMES, choose_quilt, resize_tile
from metapp.learning.components import Sight, VisibleData
from metapp.learning.random_tensors import draw_normal, draw_uniform
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec
from metapp.networks.quilted import fetch_pieces

JUDGED_PICTURES = 4  # pictures of each task whose mean error is reported
ENCODED_NAMES = ("summary", "moments", "shine")  # descriptions of exemplars that encoders alone read


@dataclass(frozen=True)
class ExemplarSight(Sight[Any, Batch]):
    """The statistics of an exemplar, and noise, which pictures are generated from.

    What is seen is a dictionary, as octaves differ in the number of their statistics.

    Attributes:
        statistics: the statistics that describe exemplars, and the distance of pictures from them.
        noise_channels: the number of channels of noise.
        candidates: the number of quilts of which a fit begins with the best one; 0 for tasks without quilts.
        min_crop_share: the shortest side of random crops of training exemplars over the exemplar's side; 1 for none.
    """

    statistics: Statistics
    noise_channels: int
    candidates: int = 0
    min_crop_share: float = 1.0

    @override
    def describe_visible(self, task: Task) -> VisibleData:
        """Return what steps see, all of the exemplar, which General's encoder reads, too."""
        return VisibleData(1, task.data["image"].nbytes, 1)

    def take_exemplar(self, task: Task) -> Tensor:
        """Return the exemplar of a task, [1, 3, H, W], display values in [0, 1]."""
        return self.statistics.octaves.take_exemplar(task.data["image"][None].float() / 255)

    def describe(self, exemplars: Tensor, candidates: int, octave: int = 0) -> Batch:
        """Describe exemplars by their statistics and, in `places` and `quilt`, by their best quilts, [B, ...] each.

        Args:
            exemplars: display values [B, 3, H, W] of the size of an octave.
            candidates: the number of quilts of each exemplar; 0 for no quilts.
            octave: the octave, 0 for the whole size.
        """
        described, cells = self.statistics.describe(exemplars, octave), self.statistics.octaves.octave_size()
        if not candidates:
            return described
        unshaded = self.statistics.even_light(exemplars, described)
        avoided_px = self.statistics.find_unusable(exemplars, described)
        quilts = [
            choose_quilt(picture, remove_quadratic_trend(picture), cells, self.statistics, candidates, avoided)
            for picture, avoided in zip(unshaded, avoided_px, strict=True)
        ]
        return described | dict(zip(QUILT_NAMES, map(torch.stack, zip(*quilts, strict=True)), strict=True))

    @override
    def prepare(self, task: Task, decoder: Any) -> Batch:
        """Return `image`, uint8 [3, S, S], and what describes the exemplar in it."""
        described = self.describe(self.take_exemplar(task), self.candidates)
        return {"image": task.data["image"]} | {name: value[0] for name, value in described.items()}

    @override
    def coarsen(self, tasks: Tasks, done: float) -> Tasks:
        """Return tasks without the statistics of octaves that are too fine for this share of a descent's steps."""
        octaves = self.statistics.octaves
        if not (coarse := sum(done < share for share in octaves.shares)):
            return tasks
        finer_maps = range(octaves.count_maps(coarse), octaves.count_maps(0))
        omitted_names = {f"{name}{index}" for name in self.statistics.statistic_names for index in finer_maps}
        return replace(tasks, data={key: value for key, value in tasks.data.items() if key not in omitted_names})

    @override
    def gather(self, tasks: Tasks) -> Batch:
        """Return all that is compared and encoded, and the noise of JUDGED_PICTURES that no fit draws."""
        shape = JUDGED_PICTURES, self.noise_channels, *self.statistics.octaves.octave_size()
        noise = fixed_noise(tasks.rows, shape, JUDGED_SEED)
        return {"noise": noise} | self.statistics.targets(tasks) | gather_known(tasks, *ENCODED_NAMES, *QUILT_NAMES)

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Draw `noise` [T, count, C, H, W] of pictures, and add what these are compared with, and the quilts."""
        targets, octaves = self.statistics.targets(tasks, rng), self.statistics.octaves
        shape = len(tasks), count, self.noise_channels, *octaves.octave_size(octaves.find_octave(tasks.data))
        return {"noise": draw_normal(rng, *shape)} | targets | gather_known(tasks, *QUILT_NAMES)

    @override
    def read(self, batch: Batch) -> Batch:
        return batch

    @override
    def loss(self, answer: Any, seen: Batch, loss_parameters: Params) -> Tensor:
        return self.statistics.loss(answer, seen)

    @override
    def task_parameters(self, tasks: Tasks, decoder: Any) -> Params:
        """Return the quilts."""
        return gather_known(tasks, *QUILT_NAMES)

    @property
    @override
    def task_parameter_specs(self) -> Mapping[str, TensorSpec]:
        cells = self.statistics.octaves.octave_size()
        return {"places": TensorSpec((2, *cells)), "quilt": TensorSpec((3, *cells))} if self.candidates else {}

    @override
    def complete(self, answer: Any, seen: Batch) -> Any:
        """Return the pictures or maps of an answer."""
        return answer.prediction

    def vary(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Crop, flip and transpose the exemplars and permute their channels, at random; each is quilted once."""
        count, octave = len(tasks), self.statistics.octaves.find_octave(tasks.data)
        is_flipped, is_transposed = draw_uniform(rng, 2, count) < 0.5
        exemplars = []
        for row, *turning in zip(tasks.rows, is_flipped.tolist(), is_transposed.tolist(), strict=True):
            image = tasks.data["image"][row].float() / 255
            image = crop_at_random(image, self.min_crop_share, rng) if self.min_crop_share < 1 else image
            exemplars.append(self.statistics.octaves.take_exemplar(turn_picture(image, *turning)[None], octave))
        channels = draw_uniform(rng, count, 3).argsort(1)
        images = torch.cat(exemplars)
        images = images.gather(1, channels[..., None, None].expand(images.shape))
        truth = self.statistics.vary_truth(tasks, is_flipped, is_transposed, channels)
        return tasks.make_variants(self.describe(images, min(self.candidates, 1), octave) | truth)

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
            photo = self.statistics.take_even_photo(task.data["image"])
            cells = self.statistics.octaves.octave_size()
            return fetch_pieces(photo, theta["places"][0], (photo.shape[1], photo.shape[2]), cells)[None]
        quilt = theta["quilt"]
        warnings.warn(
            f"{task.name}: its photo is not at hand, expected for the photo's resolution; {subject} "
            f"{quilt.shape[-1]} px a side. Give the photo, too, or fit it again.",
            stacklevel=2,
        )
        return quilt

    def resize_tile(self, task: Task, layers: Tensor, colours: Tensor, size: tuple[int, int]) -> Tensor:
        """Make a tile of another size from pieces of a tile, and warn if that cuts regular structure of the photograph.

        Args:
            task: the task that was fitted; without a photograph in it there is no warning.
            layers, colours, size: the arguments of :func:`metapp.apps.exemplar.quilts.resize_tile`.

        Returns:
            [C, *size].
        """
        resized = resize_tile(layers, colours, size)
        if "image" in task.data:
            resized.warn_of_lost_order(self.take_exemplar(task)[0], task.name)
        return resized.layers


def crop_at_random(image: Tensor, min_share: float, rng: Generator) -> Tensor:
    """Crop a square [3, s, s] at a random place and scale, s >= min_share S, from an image [3, S, S]."""
    size = image.shape[-1]
    scale, left, top = draw_uniform(rng, 3).tolist()
    side = round(size * (min_share + (1 - min_share) * scale))
    x, y = round(left * (size - side)), round(top * (size - side))
    return image[:, y : y + side, x : x + side]
