"""Textures: a network from noise to a texture with the visual statistics of an exemplar (paper section 4.1.1)."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Generator, Tensor

from metapp.appearance.features import distance, gram
from metapp.apps.exemplar.app import Crop, ExemplarApp
from metapp.learning.app import ErrorMeasure
from metapp.learning.draws import uniform
from metapp.learning.task import Batch, Params, Tasks, TensorSpec
from metapp.networks.layout import astray

SMALLEST_CROP = 0.5


class Texture(ExemplarApp):
    """One exemplar of a stationary texture a task."""

    name = "texture"
    error_measure = ErrorMeasure("relative L1 distance of Gram matrices, mean over taps and generated textures")
    reduced = True
    tensors: ClassVar = {"image": TensorSpec((3, "S", "S"), "uint8")}

    @torch.no_grad()
    def describe(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Gram matrices `gram0`... [B, C, C] and `summary`, means and root mean squares of features."""
        maps = self.features(exemplars, octave)
        return {f"gram{i}": gram(each) for i, each in enumerate(maps)} | {"summary": self.summary(maps, octave)}

    def generate(self, theta: Params, noise: Tensor, octave: int = 0) -> Tensor:
        """Textures [T, B, 3, H, W], sRGB in [0, 1], from noise [T, B, C, H, W] of the size of an octave."""
        return torch.sigmoid(self.made(theta, noise, octave))

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """`noise` for `count` textures of each task, and the exemplars' Gram matrices."""
        octave = self.octave(tasks.data)
        return {"noise": self.noise(rng, len(tasks), count, octave=octave)} | self._targets(tasks)

    def _targets(self, tasks: Tasks) -> Batch:
        return {key: value[tasks.rows] for key, value in tasks.data.items() if key.startswith(("gram", "detail"))}

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Relative L1 distance of Gram matrices, [T]; how far pictures are from their layouts; how soft they are."""
        octave, noise = self.octave(batch), batch["noise"]
        images = self.generate(theta, noise, octave)
        apart = self._distance(images, batch, self._strip)
        return apart + astray(theta, noise, images, self.layout_ratio(octave)) + self.softness(images, batch)

    def _strip(self, images: Tensor) -> Tensor:
        """As many rows as the coarsest octave has; noise and layouts are moved at each step."""
        return images[..., : self.height >> self.octaves - 1, :]

    def _distance(self, images: Tensor, batch: Batch, crop: Crop | None = None) -> Tensor:
        maps = self.features(images.flatten(0, 1), self.octave(batch), crop)
        grams = [gram(each).unflatten(0, images.shape[:2]) for each in maps]
        return distance(grams, [batch[f"gram{i}"][:, None] for i in range(len(maps))]).mean(1)

    @torch.no_grad()
    def errors_of(self, answer: Tensor, tasks: Tasks) -> dict[str, Tensor]:
        """Of pictures [T, B, 3, H, W] of the exemplar's size, sRGB in [0, 1]."""
        return {"error": self._distance(answer, self._targets(tasks))}

    def crop(self, image: Tensor, rng: Generator) -> Tensor:
        """A square part of the image, at a random place and scale."""
        size = image.shape[-1]
        scale, left, top = uniform(rng, 3).tolist()
        side = round(size * (SMALLEST_CROP + (1 - SMALLEST_CROP) * scale))
        x, y = round(left * (size - side)), round(top * (size - side))
        return image[:, y : y + side, x : x + side]
