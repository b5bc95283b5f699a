"""Small recipes of two octaves, and tasks for them."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Generator

from metapp.learning.app import App, stack
from metapp.learning.recipe import Recipe
from metapp.learning.task import Task, Tasks
from metapp.networks.exemplar import ExemplarSetup
from metapp.networks.generators import Pyramid

TAPS = ("relu1_1", "relu2_1", "relu3_1")


def tiny(full: Recipe, side: int, share: float) -> Recipe:
    """The recipe with a small network: pictures of `side` texels, after a share of the steps at half of that."""
    network = Pyramid(4, 3, code=8, outputs=full.setup.network.outputs)
    return replace(full, setup=ExemplarSetup(side, side, network, "vgg16", TAPS, octaves=2, shares=(share,)))


def noise_tasks(app: App, count: int) -> Tasks:
    """Exemplars of white noise, the same each time."""
    rng = Generator().manual_seed(0)
    images = torch.randint(256, (count, 3, 64, 64), generator=rng, dtype=torch.uint8)
    return stack(app, [Task(f"noise {i}", {"image": image}) for i, image in enumerate(images)])
