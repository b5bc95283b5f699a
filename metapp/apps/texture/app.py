"""The application of textures: Gram matrices of features of generated pictures are fitted to an exemplar's.

General's encoder and data augmentation are in :mod:`metapp.apps.exemplar.app`, generators in :mod:`metapp.networks`;
here is what makes a texture of the network's output and what is compared with the exemplar.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.features import gram, statistics_distance
from metapp.apps.exemplar.app import ExemplarApp
from metapp.apps.exemplar.exemplar_statistics import Statistics
from metapp.learning.app import ErrorMeasure
from metapp.learning.random_tensors import draw_uniform
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec

MIN_CROP_SHARE = 0.5  # shortest side of random crops over the side of the exemplar


class GramStatistics(Statistics):
    """Statistics of exemplars by Gram matrices of features, means over the whole picture."""

    reduced_precision = True

    @override
    @torch.no_grad()
    def describe(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Compute the Gram matrix [B, C, C] of each feature map, `gram0`, `gram1` and so on, and `summary` [B, S]."""
        maps = self.compute_features(exemplars, octave)
        return {f"gram{i}": gram(features) for i, features in enumerate(maps)} | {
            "summary": self.summarise(maps, octave)
        }

    def targets(self, tasks: Tasks) -> Batch:
        """Return what pictures are compared with in fits: Gram matrices of the exemplars, [T, C, C] each."""
        return {key: value[tasks.rows] for key, value in tasks.data.items() if key.startswith("gram")}

    def gram_distance(self, pictures: Tensor, batch: Batch) -> Tensor:
        """Return the relative L1 distance of pictures' Gram matrices from the exemplars', [T].

        Args:
            pictures: pictures [T, B, 3, H, W] of an octave's size, sRGB in [0, 1].
            batch: what :meth:`targets` returns.
        """
        maps = self.compute_features(pictures.flatten(0, 1), self.octaves.find_octave(batch))
        grams = [gram(features).unflatten(0, pictures.shape[:2]) for features in maps]
        return statistics_distance(grams, [batch[f"gram{i}"][:, None] for i in range(len(maps))]).mean(1)

    @override
    @torch.no_grad()
    def errors(self, prediction: Tensor, tasks: Tasks) -> dict[str, Tensor]:
        """Measure pictures [T, B, 3, H, W] of the exemplar's size, sRGB in [0, 1], by Gram matrices: `error` [T]."""
        return {"error": self.gram_distance(prediction, self.targets(tasks))}


class Texture(ExemplarApp):
    """The application of textures: a task is one exemplar of a stationary texture."""

    name = "texture"
    error_measure = ErrorMeasure("relative L1 distance of Gram matrices, mean over taps and generated textures")
    tensors: ClassVar = {"image": TensorSpec((3, "S", "S"), "uint8")}

    @property
    @override
    def statistics(self) -> GramStatistics:
        return GramStatistics(self.octaves)

    @override
    def generate(self, theta: Params, noise: Tensor, octave: int = 0) -> Tensor:
        """Generate textures [T, B, 3, H, W], sRGB in [0, 1], from noise [T, B, C, H, W] of the size of an octave."""
        return torch.sigmoid(self.network(theta, noise))

    @torch.no_grad()
    def draw_tile(self, theta: Params, task: Task, size: tuple[int, int] | None) -> Tensor:
        """Draw the texture of a fit for a file; it tiles.

        Args:
            theta: a fit, with a task axis of length 1.
            task: the task that was fitted.
            size: height and width in px; None for the usual size.

        Returns:
            The texture [3, H, W], sRGB in [0, 1].
        """
        return self.generate(theta, self.shown_noise(theta["z"], self.file_size(size)))[0, 0]

    def take_file_exemplar(self, task: Task) -> Tensor:
        """Return the exemplar [3, H, W], sRGB in [0, 1], in which structures are as large as in files."""
        return self.octaves.take_exemplar(task.data["image"][None].float() / 255)[0]

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Draw `noise` [T, count, C, H, W] of textures, and add what these are compared with."""
        noise = self.draw_noise(rng, len(tasks), count, self.octaves.find_octave(tasks.data))
        return {"noise": noise} | self.statistics.targets(tasks)

    @override
    def loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the relative L1 distance of Gram matrices, [T]."""
        pictures = self.generate(theta, batch["noise"], self.octaves.find_octave(batch))
        return self.statistics.gram_distance(pictures, batch)

    @override
    def crop(self, image: Tensor, rng: Generator) -> Tensor:
        """Crop a square [3, s, s] at a random place and scale from an image [3, S, S]."""
        size = image.shape[-1]
        scale, left, top = draw_uniform(rng, 3).tolist()
        side = round(size * (MIN_CROP_SHARE + (1 - MIN_CROP_SHARE) * scale))
        x, y = round(left * (size - side)), round(top * (size - side))
        return image[:, y : y + side, x : x + side]
