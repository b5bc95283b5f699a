"""Textures: a network from noise to a texture with the visual statistics of an exemplar (paper section 4.1.1)."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Generator, Tensor

from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.features import describe_precision, distance, gram
from metapp.appearance.surface import Surface
from metapp.apps.exemplar.app import SHOWN_SEED, Crop, ExemplarApp
from metapp.learning.draws import normal, uniform
from metapp.learning.pictures import Compared, Picture
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec
from metapp.networks.layout import astray

SMALLEST_CROP = 0.5
# By fits of 66 photographs that were graded by eye: on every other one, 9 of 12 broken textures are below, and 1 of 11
# intact ones.
LEAST_LINES = 0.935


class Texture(ExemplarApp):
    """One exemplar of a stationary texture a task."""

    name = "texture"
    title = "Texture"
    measure = "relative L1 distance of Gram matrices, mean over taps and generated textures"
    image_measure = "a texture of the exemplar's size beside the exemplar"
    reduced = True
    least_lines = LEAST_LINES
    tensors: ClassVar = {"image": TensorSpec((3, "S", "S"), "uint8")}

    def precision(self, device: torch.device) -> str:
        return describe_precision(device)

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

    def pictures_for_lines(self, theta: Params, made: Tensor) -> Tensor:
        """Return textures of twice the exemplar's size: as for files, layouts are quilted anew, which breaks more."""
        rng, (height, width) = Generator(made.device).manual_seed(SHOWN_SEED), made.shape[-2:]
        noise = normal(rng, 1, 1, self.network.noise, 2 * height, 2 * width).expand(len(made), -1, -1, -1, -1)
        return self.generate(theta, noise)[:, 0]

    def crop(self, image: Tensor, rng: Generator) -> Tensor:
        """A square part of the image, at a random place and scale."""
        size = image.shape[-1]
        scale, left, top = uniform(rng, 3).tolist()
        side = round(size * (SMALLEST_CROP + (1 - SMALLEST_CROP) * scale))
        x, y = round(left * (size - side)), round(top * (size - side))
        return image[:, y : y + side, x : x + side]

    def preview(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """The exemplar and a texture of its size."""
        texture, exemplar, _ = self.compared(theta, task)
        return {
            "reference": srgb_to_linear(exemplar[0]).permute(1, 2, 0),
            "fit": srgb_to_linear(texture[0]).permute(1, 2, 0),
        }

    def compared(self, theta: Params, task: Task) -> Compared:
        """A texture of the exemplar's size, and the exemplar."""
        exemplar = self.exemplar(task.data["image"][None].float() / 255)
        return Compared(self.shown(theta, self.generate)[0], exemplar)

    def pictures(self, theta: Params, task: Task) -> dict[str, Picture]:
        """The texture, of the size asked for, else four times as high and wide as in training; it tiles."""
        return {"texture": Picture(self._whole(theta, task).permute(1, 2, 0), "srgb")}

    def answer_pictures(self, answer: Tensor, task: Task) -> dict[str, Picture]:
        """The first of the textures [1, B, 3, H, W]."""
        return {"texture": Picture(answer[0, 0].permute(1, 2, 0), "srgb")}

    def surface(self, theta: Params, task: Task) -> Surface:
        return Surface(srgb_to_linear(self._whole(theta, task)), True)

    def _whole(self, theta: Params, task: Task) -> Tensor:
        """The texture of the size of files, [3, H, W]."""
        textures: Tensor = self.once(theta, task, lambda: self.shown(theta, self.generate, self.picture_size))
        return textures[0, 0]
