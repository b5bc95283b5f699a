"""Textures: a network from noise to a texture with the visual statistics of an exemplar (paper section 4.1.1)."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Generator, Tensor

from metapp.appearance.features import gram, statistics_distance
from metapp.apps.exemplar.app import ExemplarApp, draw_noise, generate_raw
from metapp.apps.exemplar.exemplar_statistics import Statistics
from metapp.apps.exemplar.octaves import Crop
from metapp.learning.app import ErrorMeasure
from metapp.learning.random_tensors import draw_uniform
from metapp.learning.task import Batch, Params, Tasks, TensorSpec
from metapp.networks.layout import layout_deviation

MIN_CROP_SHARE = 0.5


class GramStatistics(Statistics):
    """Gram matrices of the whole picture."""

    reduced = True

    @torch.no_grad()
    def describe(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Return Gram matrices `gram0`... [B, C, C] and `summary`, means and root mean squares of features."""
        maps = self.compute_features(exemplars, octave)
        return {f"gram{i}": gram(each) for i, each in enumerate(maps)} | {"summary": self.summarise(maps, octave)}

    def targets(self, tasks: Tasks) -> Batch:
        """Return what fits of tasks are compared with, [T, ...]."""
        return {key: value[tasks.rows] for key, value in tasks.data.items() if key.startswith(("gram", "detail"))}

    def distance(self, pictures: Tensor, batch: Batch, crop: Crop | None = None) -> Tensor:
        """Return the relative L1 distance of Gram matrices of pictures [T, B, 3, H, W] from those of a batch, [T]."""
        maps = self.compute_features(pictures.flatten(0, 1), self.octaves.find_octave(batch), crop)
        grams = [gram(each).unflatten(0, pictures.shape[:2]) for each in maps]
        return statistics_distance(grams, [batch[f"gram{i}"][:, None] for i in range(len(maps))]).mean(1)

    @torch.no_grad()
    def errors(self, answer: Tensor, tasks: Tasks) -> dict[str, Tensor]:
        """Measure pictures [T, B, 3, H, W] of the exemplar's size, sRGB in [0, 1]."""
        return {"error": self.distance(answer, self.targets(tasks))}


class Texture(ExemplarApp):
    """One exemplar of a stationary texture a task."""

    name = "texture"
    error_measure = ErrorMeasure("relative L1 distance of Gram matrices, mean over taps and generated textures")
    tensors: ClassVar = {"image": TensorSpec((3, "S", "S"), "uint8")}

    @property
    def statistics(self) -> GramStatistics:
        return GramStatistics(self.octaves)

    def generate(self, theta: Params, noise: Tensor, octave: int = 0) -> Tensor:
        """Textures [T, B, 3, H, W], sRGB in [0, 1], from noise [T, B, C, H, W] of the size of an octave."""
        return torch.sigmoid(generate_raw(self, theta, noise, octave))

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """`noise` for `count` textures of each task, and the exemplars' Gram matrices."""
        noise = draw_noise(self, rng, len(tasks), count, octave=self.octaves.find_octave(tasks.data))
        return {"noise": noise} | self.statistics.targets(tasks)

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Relative L1 distance of Gram matrices, [T]; how far pictures are from their layouts; how soft they are."""
        statistics, octave, noise = self.statistics, self.octaves.find_octave(batch), batch["noise"]
        images = self.generate(theta, noise, octave)
        apart = statistics.distance(images, batch, self._take_strip)
        apart = apart + layout_deviation(theta, noise, images, self.octaves.layout_ratio(octave))
        return apart + statistics.softness(images, batch)

    def _take_strip(self, images: Tensor) -> Tensor:
        """Take as many rows as the coarsest octave has; noise and layouts are moved at each step."""
        return images[..., : self.octaves.size(self.octaves.count - 1)[0], :]

    def crop(self, image: Tensor, rng: Generator) -> Tensor:
        """A square part of the image, at a random place and scale."""
        size = image.shape[-1]
        scale, left, top = draw_uniform(rng, 3).tolist()
        side = round(size * (MIN_CROP_SHARE + (1 - MIN_CROP_SHARE) * scale))
        x, y = round(left * (size - side)), round(top * (size - side))
        return image[:, y : y + side, x : x + side]
