"""Textures: a network from noise to a texture with the visual statistics of an exemplar (paper section 4.1.1)."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Generator, Tensor

from metapp.appearance.features import distance, gram
from metapp.learning.recipe import AS_PUBLISHED, Adam, MetaTraining, OuterLoop, Recipe
from metapp.learning.task import Batch, Held, Params, Tasks
from metapp.networks.exemplar import ExemplarApp, Setup, full_recipe
from metapp.networks.layers import UNet

SMALLEST_CROP = 0.5
LEARNED = MetaTraining(
    steps=300,
    tasks=4,
    rates={"": 1e-3, "alpha.": 1e-2},
    first=Adam(3.7e-3, beta1=0.7, beta2=0.99, final=0.3),
    warmup=20,
    final=0.01,
    order=1,
    clip=1e-2,
    validate_every=100,
)
ENCODED = replace(LEARNED, start="encoder", rates={"": 1e-4, "alpha.": 3e-3})
TUNED = MetaTraining(
    steps=0, tasks=0, rates={"": 0.0}, first=Adam(5e-3, beta1=0.5, beta2=0.99, final=0.6), tuned=True, start="encoder"
)
QUICK = Recipe(
    steps=15,
    batch=1,
    overfit_steps=1000,
    overfit=Adam(5e-3, beta2=0.99, final=0.0),
    finetune_steps=100,
    finetune=Adam(5e-3, beta2=0.99, final=0.0),
    quickft=Adam(3.7e-3, beta1=0.7, beta2=0.99, final=0.3),
    general=OuterLoop(steps=4000, tasks=8, rates={"": 3e-3, "encoder.mlp": 1e-3}, warmup=50, final=0.0),
    meta={
        "meta-sgd": replace(LEARNED, first=Adam(0.1)),
        "meta-adam-tied": LEARNED,
        "meta-encoder": ENCODED,
        "meta-mean": TUNED,
        "meta-basis": TUNED,
    },
    rule="meta-basis",
    setup=Setup(64, 64, UNet(16), "vgg16", ("relu1_1", "relu2_1", "relu3_1")),
)
FULL = full_recipe(QUICK, found=Adam(4.4e-3, beta1=0.5, beta2=0.97, final=0.1), tasks=4)

# Fischer & Ritschel 2022, section 4.1.1 and supplement: 15 inner steps, first-order MAML with Meta-SGD, meta-batch 5,
# a random start
PAPER = replace(
    QUICK,
    overfit_steps=10_000,
    finetune_steps=1_000,
    meta={"meta-sgd": AS_PUBLISHED},
    rule="meta-sgd",
    setup=Setup(192, 256, UNet(32), "vgg16", ("relu1_2", "relu2_2", "relu3_3", "relu4_3", "relu5_3")),
)
# the authors' features
VGG19 = replace(
    PAPER,
    setup=replace(PAPER.setup, features="vgg19", taps=("relu1_2", "relu2_2", "relu3_4", "relu4_4", "relu5_4")),
)


class Texture(ExemplarApp):
    """One exemplar of a stationary texture a task."""

    name = "texture"
    reduced = True
    holds = {"image": Held((3, "S", "S"), "uint8")}  # noqa: RUF012  (never written to)
    recipes = {"paper": PAPER, "paper-vgg19": VGG19, "quick": QUICK, "full": FULL}  # noqa: RUF012  (never written to)

    @torch.no_grad()
    def describe(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Gram matrices `gram0`... [B, C, C] and `summary`, means and root mean squares of features."""
        maps = self.features(exemplars, octave)
        return {f"gram{i}": gram(each) for i, each in enumerate(maps)} | {"summary": self.summary(maps, octave)}

    def generate(self, theta: Params, noise: Tensor, octave: int = 0) -> Tensor:
        """Textures [T, B, 3, H, W], sRGB in [0, 1], from noise [T, B, C, H, W] of the size of an octave."""
        return torch.sigmoid(self.setup.at(octave)(theta, noise))

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """`noise` for `count` textures of each task, and the exemplars' Gram matrices."""
        octave = self.octave(tasks.data)
        return {"noise": self.noise(rng, len(tasks), count, octave=octave)} | self._targets(tasks)

    def _targets(self, tasks: Tasks) -> Batch:
        return {key: value[tasks.rows] for key, value in tasks.data.items() if key.startswith("gram")}

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Relative L1 distance of Gram matrices, [T]."""
        return self._distance(self.generate(theta, batch["noise"], self.octave(batch)), batch)

    def _distance(self, images: Tensor, batch: Batch) -> Tensor:
        maps = self.features(images.flatten(0, 1), self.octave(batch))
        found = [gram(each).unflatten(0, images.shape[:2]) for each in maps]
        return distance(found, [batch[f"gram{i}"][:, None] for i in range(len(maps))]).mean(1)

    @torch.no_grad()
    def errors_of(self, answer: Tensor, tasks: Tasks) -> dict[str, Tensor]:
        """Of pictures [T, B, 3, H, W] of the exemplar's size, sRGB in [0, 1]."""
        return {"error": self._distance(answer, self._targets(tasks))}

    def crop(self, image: Tensor, rng: Generator) -> Tensor:
        """A square part of the image, at a random place and scale."""
        size = image.shape[-1]
        scale, left, top = torch.rand(3, generator=rng, device=rng.device).tolist()
        side = round(size * (SMALLEST_CROP + (1 - SMALLEST_CROP) * scale))
        x, y = round(left * (size - side)), round(top * (size - side))
        return image[:, y : y + side, x : x + side]


APP = Texture(QUICK.setup)
