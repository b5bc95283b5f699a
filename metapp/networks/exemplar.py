"""What applications share that generate, from noise, a picture with the visual statistics of an exemplar photograph."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import torch
from torch import Generator, Tensor
from torch.nn.functional import interpolate, leaky_relu

from metapp.appearance.features import Features, describe_features, load_features
from metapp.learning.app import App
from metapp.learning.recipe import Recipe
from metapp.learning.task import Batch, Params, Task, Tasks
from metapp.networks.coded import decoder_of, with_decoder
from metapp.networks.layers import UNet

HIDDEN = 128
JUDGED = 4


@dataclass(frozen=True)
class Setup:
    """The size of everything.

    Attributes:
        height, width: texels of the exemplar and of what is generated in training.
        network: the generator.
        features: "vgg16" or "vgg19".
        taps: the layers whose statistics are compared.
    """

    height: int
    width: int
    network: UNet
    features: str
    taps: tuple[str, ...]


class ExemplarApp(App):
    """A generator of pictures from noise, fitted to the statistics of one photograph a task.

    General's encoder is a network from a summary of the photograph's features to the generator's code z; the
    generator's other parameters are then the same for all tasks.
    """

    setup: Setup

    def __init__(self, setup: Setup) -> None:
        self.setup = setup

    def at(self, recipe: Recipe, protocol: str = "") -> Self:
        return type(self)(recipe.setup)

    def conditions(self) -> dict[str, str]:
        return {"features": describe_features(self.setup.features)}

    def features(self, like: Tensor) -> Features:
        """The features, on the device and in the precision of a tensor."""
        return load_features(self.setup.features, self.setup.taps, like)

    def describe(self, exemplars: Tensor) -> dict[str, Tensor]:
        """All that fitting and encoding need of exemplars [B, 3, h, w], sRGB in [0, 1]; `summary` [B, S] among it."""
        raise NotImplementedError

    def summary_size(self) -> int:
        """S, the length of the encoder's input."""
        raise NotImplementedError

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """`image` uint8 [3, S, S], and what describes the exemplar in it."""
        image = task.data["image"]
        described = self.describe(self.exemplar(image[None].float() / 255))
        return {"image": image} | {key: value[0] for key, value in described.items()}

    def exemplar(self, images: Tensor) -> Tensor:
        """The part of square images [B, 3, S, S] that has the recipe's proportions, resampled to its size."""
        rows = round(images.shape[-1] * self.setup.height / self.setup.width)
        top = (images.shape[-2] - rows) // 2
        size = (self.setup.height, self.setup.width)
        part = images[..., top : top + rows, :]
        return interpolate(part, size=size, mode="area" if part.shape[-2] >= size[0] else "bilinear")

    def init(self, rng: Generator, count: int) -> Params:
        return self.setup.network.init(rng, count)

    def noise(self, rng: Generator, tasks: int, count: int, times: int = 1) -> Tensor:
        """Standard normal [tasks, count, C, h, w], `times` as high and wide as in training."""
        size = (self.setup.height * times, self.setup.width * times)
        return torch.randn(tasks, count, self.setup.network.noise, *size, generator=rng, device=rng.device)

    def init_encoder(self, rng: Generator) -> Params:
        encoder = decoder_of(self.init(rng, 1), ("z",))
        sizes = (self.summary_size(), HIDDEN, HIDDEN, self.setup.network.code)
        for layer in (1, 2, 3):
            inputs, outputs = sizes[layer - 1], sizes[layer]
            noise = torch.randn(outputs, inputs, generator=rng, device=rng.device)
            encoder[f"mlp{layer}.w"] = noise * math.sqrt(2 / inputs)
            encoder[f"mlp{layer}.b"] = torch.zeros(outputs, device=rng.device)
        return encoder

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        return {"summary": tasks.data["summary"][tasks.rows]}

    def encode(self, encoder: Params, condition: Batch) -> Params:
        x = torch.log(condition["summary"] + 0.01) / 2  # features are heavy-tailed
        for layer in (1, 2, 3):
            x = x @ encoder[f"mlp{layer}.w"].T + encoder[f"mlp{layer}.b"]
            x = leaky_relu(x, 0.2) if layer < 3 else x
        return with_decoder({"z": x}, encoder)

    def crop(self, image: Tensor, rng: Generator) -> Tensor:
        """A part [3, s, s] of an image [3, S, S] that could have been photographed as well; here all of it."""
        return image

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """These exemplars cropped, flipped, transposed and with their channels permuted, at random."""
        count, device = len(tasks), rng.device
        exemplars = []
        for row, flip, turn in zip(
            tasks.rows, *torch.rand(2, count, generator=rng, device=device).tolist(), strict=True
        ):
            image = self.crop(tasks.data["image"][row].float() / 255, rng)
            image = image.flip(-1) if flip < 0.5 else image
            exemplars.append(self.exemplar((image.mT if turn < 0.5 else image)[None]))
        channels = torch.rand(count, 3, generator=rng, device=device).argsort(1)[..., None, None]
        images = torch.cat(exemplars)
        images = images.gather(1, channels.expand(images.shape))
        return tasks.variants(self.describe(images))

    @torch.no_grad()
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """On textures from noise that no fit has seen, the same for all."""
        rng = Generator(tasks.rows.device).manual_seed(0)
        noise = self.noise(rng, 1, JUDGED).expand(len(tasks), -1, -1, -1, -1)
        return {"error": self.loss(theta, self.sample(tasks, rng, 1) | {"noise": noise}, {})}
