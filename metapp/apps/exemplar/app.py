"""Applications that generate, from noise, a picture with the visual statistics of an exemplar photograph."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Generator, Tensor
from torch.nn.functional import leaky_relu

from metapp.appearance.features import detail_statistics, feature_conditions
from metapp.apps.exemplar.exemplar_statistics import Statistics
from metapp.apps.exemplar.octaves import Octaves
from metapp.learning.app import App
from metapp.learning.random_tensors import draw_normal, draw_uniform
from metapp.learning.recipe import Recipe
from metapp.learning.task import Batch, Params, Task, Tasks
from metapp.networks.coded import add_decoder, join_encoder
from metapp.networks.generators import Pyramid, UNet
from metapp.networks.layout import move_layouts, normalise_layouts, quilt_layout

HIDDEN_UNITS = 128
JUDGED_PICTURES = 4


def set_detail(recipe: Recipe, side: int) -> Recipe:
    """A recipe for exemplars of another side in px: that of training, or, with a layout, twice that.

    Raises:
        ValueError: its application has no such choice.
    """
    app, sides = recipe.app, tuple[int, ...]()
    assert isinstance(app, ExemplarApp)
    octaves = app.octaves
    if app.network.has_layout:
        trained = octaves.width >> octaves.finer
        sides = (trained, 2 * trained)
    if side not in sides:
        expected = f"one of {', '.join(map(str, sides))}" if sides else "no choice; take another recipe"
        raise ValueError(f"expected {expected}")
    finer = sides.index(side)
    height = (octaves.height >> octaves.finer) << finer
    return replace(recipe, app=replace(app, octaves=replace(octaves, height=height, width=side, finer=finer)))


@dataclass(frozen=True)
class ExemplarApp(App):
    """A generator of pictures from noise, fitted to the statistics of one photograph a task.

    General's encoder is a network from a summary of the photograph's features to the generator's code z; the
    generator's other parameters are then the same for all tasks.

    Attributes:
        network: the generator.
        octaves: the sizes at which pictures are compared with the exemplar.
    """

    network: UNet | Pyramid = field()
    octaves: Octaves = field()

    @property
    @abstractmethod
    def statistics(self) -> Statistics:
        """What is known of exemplars, and the distance of pictures from it."""

    @property
    def read_size(self) -> int:
        return self.octaves.width if self.octaves.finer else 0

    def conditions(self, device: torch.device | None = None) -> dict[str, str]:
        return feature_conditions(device if self.statistics.reduced else None)

    def stage(self, tasks: Tasks, done: float) -> Tasks:
        """From coarse to fine: at first statistics of the coarsest octave alone."""
        octaves = self.octaves
        if not (coarse := sum(done < share for share in octaves.shares)):
            return tasks
        finer = range(octaves.count_maps(coarse), octaves.count_maps(0))
        left_out = {f"{name}{i}" for name in self.statistics.names for i in finer}
        return replace(tasks, data={key: value for key, value in tasks.data.items() if key not in left_out})

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """`image` uint8 [3, S, S], and statistics of the exemplar in it.

        Raises:
            ValueError: the picture is smaller than finer exemplars than those of training.
        """
        image, octaves = task.data["image"], self.octaves
        if octaves.finer and image.shape[-1] < (side := octaves.width):
            raise ValueError(f"{task.name}: {image.shape[-1]} px a side, --detail {side} expects {side}; leave it out.")
        exemplar = octaves.take_exemplar(image[None].float() / 255)
        return {"image": image} | {key: value[0] for key, value in self._targets(exemplar).items()}

    def _targets(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Return all that fits compare with: what describes exemplars [B, 3, h, w], and layouts if networks read them.

        `layout` [B, 3, h, w] is a coarse picture that tiles, quilted of the exemplar; `detail_statistics` [B, 3, N] goes with it.
        """
        described = self.statistics.describe(exemplars, octave)
        if not self.network.has_layout:
            return described
        even, size = self.statistics.evenly_lit(exemplars, described), self.octaves.layout_size
        made = torch.stack([quilt_layout(each, size) for each in even])
        return described | {"layout": made, "detail": detail_statistics(exemplars)}

    def task_parameters(self, tasks: Tasks) -> Params:
        """The layouts, if the network reads one."""
        return {"layout": tasks.data["layout"][tasks.rows]} if self.network.has_layout else {}

    def init(self, rng: Generator, count: int) -> Params:
        theta = self.network.init(rng, count)
        if self.network.has_layout:
            theta["layout"] = torch.zeros(count, 3, *self.octaves.layout_size, device=rng.device)
        return theta

    @abstractmethod
    def generate(self, theta: Params, noise: Tensor, octave: int = 0) -> Any:
        """Return the pictures or maps [T, B, ...] that are judged, from noise [T, B, C, H, W] of an octave's size."""

    @torch.no_grad()
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """Measure pictures from noise that no fit draws, the same for all."""
        return self.errors_of(self.generate(theta, fixed_noise(self, tasks.rows, JUDGED_PICTURES)), tasks)

    def errors_of(self, answer: Any, tasks: Tasks) -> dict[str, Tensor]:
        """Measure pictures or maps that need not come from the network, by `Statistics.errors`."""
        return self.statistics.errors(answer, tasks)

    def init_encoder(self, rng: Generator) -> Params:
        encoder = join_encoder({}, self.network.init(rng, 1), ("z",))
        sizes = (self.statistics.summary_size, HIDDEN_UNITS, HIDDEN_UNITS, self.network.code)
        for layer in (1, 2, 3):
            inputs, outputs = sizes[layer - 1], sizes[layer]
            noise = draw_normal(rng, outputs, inputs)
            encoder[f"mlp{layer}.w"] = noise * math.sqrt(2 / inputs)
            encoder[f"mlp{layer}.b"] = torch.zeros(outputs, device=rng.device)
        return encoder

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        return {"summary": tasks.data["summary"][tasks.rows]} | self.task_parameters(tasks)

    def encode(self, encoder: Params, condition: Batch) -> Params:
        x = torch.log(condition["summary"] + 0.01) / 2  # features are heavy-tailed
        for layer in (1, 2, 3):
            x = x @ encoder[f"mlp{layer}.w"].T + encoder[f"mlp{layer}.b"]
            x = leaky_relu(x, 0.2) if layer < 3 else x
        return add_decoder({"z": x} | {key: condition[key] for key in ("layout",) if key in condition}, encoder)

    def crop(self, image: Tensor, rng: Generator) -> Tensor:
        """A part [3, s, s] of an image [3, S, S] that could have been photographed as well; here all of it."""
        return image

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """These exemplars cropped, flipped, transposed and with their channels permuted, at random."""
        count, octave = len(tasks), self.octaves.find_octave(tasks.data)
        exemplars = []
        for row, flip, turn in zip(tasks.rows, *draw_uniform(rng, 2, count).tolist(), strict=True):
            image = self.crop(tasks.data["image"][row].float() / 255, rng)
            image = image.flip(-1) if flip < 0.5 else image
            exemplars.append(self.octaves.take_exemplar((image.mT if turn < 0.5 else image)[None], octave))
        channels = draw_uniform(rng, count, 3).argsort(1)[..., None, None]
        images = torch.cat(exemplars)
        images = images.gather(1, channels.expand(images.shape))
        return tasks.make_variants(self._targets(images, octave) | self.carried(tasks, channels[..., 0, 0]))

    def carried(self, tasks: Tasks, channels: Tensor) -> dict[str, Tensor]:
        """Further data of these exemplars, once their channels are those [T, 3] of before."""
        return {}


def draw_noise(app: ExemplarApp, rng: Generator, tasks: int, count: int, *, octave: int = 0) -> Tensor:
    """Draw standard normal numbers [tasks, count, C, h, w] for pictures of the size of an octave."""
    return draw_normal(rng, tasks, count, app.network.noise, *app.octaves.size(octave))


def fixed_noise(app: ExemplarApp, like: Tensor, count: int, *, seed: int = 0, octave: int = 0) -> Tensor:
    """Return noise that is the same for all tasks and no fit draws, [tasks, count, C, h, w].

    Args:
        app: the application.
        like: a tensor with one entry a task, on the device that noise is to be on.
        count: of pictures of each task.
        seed: of the draw.
        octave: that pictures are as large as, 0 for the whole size.
    """
    rng = Generator(like.device).manual_seed(seed)
    return draw_noise(app, rng, 1, count, octave=octave).expand(len(like), -1, -1, -1, -1)


def generate_raw(app: ExemplarApp, theta: Params, noise: Tensor, octave: int = 0) -> Tensor:
    """Return the network's output from noise [T, B, C, H, W], before any range is imposed; it tiles.

    Args:
        app: the application.
        theta: fits [T, ...], with the `layout` of each if the network reads one.
        noise: of the size of an octave, or another: layouts are then quilted anew.
        octave: 0 for the whole size.
    """
    network = app.network
    if not isinstance(network, Pyramid):
        return network(theta, noise)
    network = network._replace(finest=octave)
    if not network.has_layout:
        return network(theta, noise)
    moved = move_layouts(theta["layout"], noise, app.octaves.layout_ratio(octave))
    return network(theta, noise, normalise_layouts(moved, noise))
