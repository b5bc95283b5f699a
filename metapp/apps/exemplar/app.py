"""The base of applications that generate, from noise, a picture with the visual statistics of an exemplar photograph.

Here are the generator, General's encoder, layouts and data augmentation. An application says what is compared with the
exemplar by a subclass of :class:`metapp.apps.exemplar.exemplar_statistics.Statistics`.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Generator, Tensor
from torch.nn.functional import leaky_relu
from typing_extensions import override

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

HIDDEN_UNITS = 128  # units of each hidden layer of General's encoder
JUDGED_PICTURES = 4  # pictures of each task whose mean error is reported


def set_detail(recipe: Recipe, side: int) -> Recipe:
    """Return a recipe for exemplars of another side.

    Args:
        recipe: the recipe of an exemplar application.
        side: the side in px. Networks that read a layout have two choices: the side of training and twice that.

    Raises:
        ValueError: the recipe has no such choice.
    """
    app, sides = recipe.app, tuple[int, ...]()
    assert isinstance(app, ExemplarApp)
    octaves = app.octaves
    if app.network.has_layout:
        training_side = octaves.width >> octaves.finer
        sides = (training_side, 2 * training_side)
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
    generator's other parameters are then equal for all tasks.

    Attributes:
        network: the generator.
        octaves: the sizes at which pictures are compared with the exemplar.
    """

    network: UNet | Pyramid = field()
    octaves: Octaves = field()

    @property
    @abstractmethod
    def statistics(self) -> Statistics:
        """The statistics that describe exemplars, and the distance of pictures from them."""

    @property
    @override
    def read_size(self) -> int:
        return self.octaves.width if self.octaves.finer else 0

    @override
    def conditions(self, device: torch.device | None = None) -> dict[str, str]:
        return feature_conditions(device if self.statistics.reduced_precision else None)

    @override
    def stage(self, tasks: Tasks, done: float) -> Tasks:
        """Return tasks without the statistics of octaves that are too fine for this share of a descent's steps."""
        octaves = self.octaves
        if not (coarse := sum(done < share for share in octaves.shares)):
            return tasks
        finer_maps = range(octaves.count_maps(coarse), octaves.count_maps(0))
        omitted_names = {f"{name}{index}" for name in self.statistics.statistic_names for index in finer_maps}
        return replace(tasks, data={key: value for key, value in tasks.data.items() if key not in omitted_names})

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Return `image`, uint8 [3, S, S], and the statistics of the exemplar in it.

        Raises:
            ValueError: exemplars are to be finer than in training, and the picture is smaller than that.
        """
        image, octaves = task.data["image"], self.octaves
        if octaves.finer and image.shape[-1] < (side := octaves.width):
            raise ValueError(f"{task.name}: {image.shape[-1]} px a side, --detail {side} expects {side}; leave it out.")
        exemplar = octaves.take_exemplar(image[None].float() / 255)
        return {"image": image} | {key: value[0] for key, value in self.make_targets(exemplar).items()}

    def make_targets(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Return all that fits compare pictures with, by name, [B, ...] each.

        These are the statistics of exemplars, and if the network reads layouts, `layout` [B, 3, h, w], coarse pictures
        that tile, quilted of the exemplars, and `detail` [B, 3, N], what :func:`detail_statistics` returns.

        Args:
            exemplars: display values [B, 3, H, W] of the size of an octave.
            octave: the octave, 0 for the whole size.
        """
        targets = self.statistics.describe(exemplars, octave)
        if not self.network.has_layout:
            return targets
        evenly_lit, size = self.statistics.even_light(exemplars, targets), self.octaves.layout_size
        layouts = torch.stack([quilt_layout(exemplar, size) for exemplar in evenly_lit])
        return targets | {"layout": layouts, "detail": detail_statistics(exemplars)}

    @override
    def task_parameters(self, tasks: Tasks) -> Params:
        """Return the layouts, if the network reads one."""
        return {"layout": tasks.data["layout"][tasks.rows]} if self.network.has_layout else {}

    @override
    def init(self, rng: Generator, count: int) -> Params:
        theta = self.network.init(rng, count)
        if self.network.has_layout:
            theta["layout"] = torch.zeros(count, 3, *self.octaves.layout_size, device=rng.device)
        return theta

    @abstractmethod
    def generate(self, theta: Params, noise: Tensor, octave: int = 0) -> Any:
        """Generate the pictures or maps [T, B, ...] that errors are of.

        Args:
            theta: fits [T, ...].
            noise: the noise of B pictures of each task, [T, B, C, H, W], of the size of an octave.
            octave: the octave, 0 for the whole size.
        """

    @override
    @torch.no_grad()
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """Measure pictures from noise that no fit draws, equal for all tasks."""
        return self.errors_of(self.generate(theta, fixed_noise(self, tasks.rows, JUDGED_PICTURES)), tasks)

    def errors_of(self, answer: Any, tasks: Tasks) -> dict[str, Tensor]:
        """Measure pictures or maps that need not come from the network; see :meth:`Statistics.errors`."""
        return self.statistics.errors(answer, tasks)

    @override
    def init_encoder(self, rng: Generator) -> Params:
        encoder = join_encoder({}, self.network.init(rng, 1), ("z",))
        widths = (self.statistics.summary_size, HIDDEN_UNITS, HIDDEN_UNITS, self.network.code)
        for layer in (1, 2, 3):
            inputs, outputs = widths[layer - 1], widths[layer]
            weights = draw_normal(rng, outputs, inputs)
            encoder[f"mlp{layer}.w"] = weights * math.sqrt(2 / inputs)
            encoder[f"mlp{layer}.b"] = torch.zeros(outputs, device=rng.device)
        return encoder

    @override
    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        return {"summary": tasks.data["summary"][tasks.rows]} | self.task_parameters(tasks)

    @override
    def encode(self, encoder: Params, condition: Batch) -> Params:
        x = torch.log(condition["summary"] + 0.01) / 2  # as features are heavy-tailed
        for layer in (1, 2, 3):
            x = x @ encoder[f"mlp{layer}.w"].T + encoder[f"mlp{layer}.b"]
            x = leaky_relu(x, 0.2) if layer < 3 else x
        return add_decoder({"z": x} | {key: condition[key] for key in ("layout",) if key in condition}, encoder)

    def crop(self, image: Tensor, rng: Generator) -> Tensor:
        """Crop an image [3, S, S] at random to [3, s, s] that could have been photographed as well; here not at all."""
        return image

    @override
    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Crop, flip and transpose the exemplars and permute their channels, at random."""
        count, octave = len(tasks), self.octaves.find_octave(tasks.data)
        exemplars = []
        for row, flipping, transposing in zip(tasks.rows, *draw_uniform(rng, 2, count).tolist(), strict=True):
            image = self.crop(tasks.data["image"][row].float() / 255, rng)
            image = image.flip(-1) if flipping < 0.5 else image
            exemplars.append(self.octaves.take_exemplar((image.mT if transposing < 0.5 else image)[None], octave))
        channels = draw_uniform(rng, count, 3).argsort(1)[..., None, None]
        images = torch.cat(exemplars)
        images = images.gather(1, channels.expand(images.shape))
        return tasks.make_variants(self.make_targets(images, octave) | self.permute_data(tasks, channels[..., 0, 0]))

    def permute_data(self, tasks: Tasks, channels: Tensor) -> dict[str, Tensor]:
        """Return further data of exemplars whose channels are permuted; here there are none.

        Args:
            tasks: the exemplars before that.
            channels: the number that each channel had before, [T, 3].
        """
        return {}


def draw_noise(app: ExemplarApp, rng: Generator, tasks: int, count: int, *, octave: int = 0) -> Tensor:
    """Draw standard normal noise [tasks, count, C, h, w] of `count` pictures of each task, of the size of an octave."""
    return draw_normal(rng, tasks, count, app.network.noise, *app.octaves.octave_size(octave))


def fixed_noise(app: ExemplarApp, like: Tensor, count: int, *, seed: int = 0, octave: int = 0) -> Tensor:
    """Return noise that is equal for all tasks and that no fit draws, [tasks, count, C, h, w].

    Args:
        app: the application.
        like: a tensor with one entry a task, on the device that noise is to be on.
        count: the number of pictures of each task.
        seed: the seed of the draw.
        octave: the octave whose size pictures have, 0 for the whole size.
    """
    rng = Generator(like.device).manual_seed(seed)
    return draw_noise(app, rng, 1, count, octave=octave).expand(len(like), -1, -1, -1, -1)


def generate_raw(app: ExemplarApp, theta: Params, noise: Tensor, octave: int = 0) -> Tensor:
    """Generate the network's output [T, B, outputs, H, W] from noise, before any range is imposed; it tiles.

    Args:
        app: the application.
        theta: fits [T, ...], with the `layout` of each if the network reads one.
        noise: the noise of B pictures of each task, [T, B, C, H, W]; if it has another size than the octave, layouts
            are quilted anew.
        octave: the octave, 0 for the whole size.
    """
    network = app.network
    if not isinstance(network, Pyramid):
        return network(theta, noise)
    network = network._replace(finest=octave)
    if not network.has_layout:
        return network(theta, noise)
    layouts = move_layouts(theta["layout"], noise, app.octaves.layout_ratio(octave))
    return network(theta, noise, normalise_layouts(layouts, noise))
