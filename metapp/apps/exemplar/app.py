"""The base of applications that generate, from noise, a picture with the visual statistics of an exemplar photograph.

Here are General's encoder, noise, data augmentation, and what all fits share; generators are in :mod:`metapp.networks`.
An application says what is compared with the exemplar by a subclass of
:class:`metapp.apps.exemplar.exemplar_statistics.Statistics`.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, leaky_relu
from typing_extensions import override

from metapp.appearance.features import feature_conditions
from metapp.apps.exemplar.exemplar_statistics import Statistics
from metapp.apps.exemplar.octaves import Octaves
from metapp.learning.app import App
from metapp.learning.random_tensors import draw_normal, draw_uniform
from metapp.learning.task import Batch, Params, Task, Tasks
from metapp.networks.coded import add_decoder, join_encoder
from metapp.networks.quilted import move_periodically

HIDDEN_UNITS = 128  # units of each hidden layer of General's encoder
ENCODER_LEAKY_SLOPE = 0.2  # slope below 0 of the leaky ReLUs of General's encoder
# Channels of noise, at least, drawn even if the network reads none: the first two numbers of the first channel say how
# far down and right tiles are moved
MIN_NOISE_CHANNELS = 2
JUDGED_PICTURES = 4  # pictures of each task whose mean error is reported
SHOWN_SEED = 1  # seed of the noise of pictures that are written and shown
FILE_SIDE_TIMES = 4  # side of a picture in files over its side in training


@dataclass(frozen=True)
class ExemplarApp(App):
    """A generator of pictures from noise, fitted to the statistics of one photograph a task.

    General's encoder is a network from a summary of the photograph's features to the generator's code z; the
    generator's other parameters are then equal for all tasks.

    Attributes:
        network: the generator.
        octaves: the sizes at which pictures are compared with the exemplar.
    """

    network: Any = field()
    octaves: Octaves = field()

    @property
    @abstractmethod
    def statistics(self) -> Statistics:
        """The statistics that describe exemplars, and the distance of pictures from them."""

    def without_quilts(self) -> ExemplarApp:
        """Return the application for methods that read no quilts: tasks are prepared without any."""
        return self

    def find_quilts(self, theta: Params) -> Quilts | None:
        """Return the quilts of fits, or of one fit without a task axis; None if the network reads none."""
        return None

    @property
    def file_side_step(self) -> int:
        """The number of px of which sides of files are multiples."""
        step: int = self.network.side_step
        return step

    def file_size(self, size: tuple[int, int] | None) -> tuple[int, int]:
        """Return the height and width of files, in px: as asked for, else FILE_SIDE_TIMES the exemplar's."""
        height, width = self.octaves.octave_size()
        return size or (FILE_SIDE_TIMES * height, FILE_SIDE_TIMES * width)

    @override
    def recorded_conditions(self, device: torch.device | None = None) -> dict[str, str]:
        return feature_conditions(device if self.statistics.reduced_precision else None)

    @override
    def coarsen(self, tasks: Tasks, done: float) -> Tasks:
        """Return tasks without the statistics of octaves that are too fine for this share of a descent's steps."""
        octaves = self.octaves
        if not (coarse := sum(done < share for share in octaves.shares)):
            return tasks
        finer_maps = range(octaves.count_maps(coarse), octaves.count_maps(0))
        omitted_names = {f"{name}{index}" for name in self.statistics.statistic_names for index in finer_maps}
        return replace(tasks, data={key: value for key, value in tasks.data.items() if key not in omitted_names})

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Return `image`, uint8 [3, S, S], and the statistics of the exemplar in it."""
        image = task.data["image"]
        exemplar = self.octaves.take_exemplar(image[None].float() / 255)
        return {"image": image} | {key: value[0] for key, value in self.make_targets(exemplar).items()}

    def make_targets(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Return what fits and General's encoder read of exemplars, by name, [B, ...] each: their statistics.

        Args:
            exemplars: display values [B, 3, H, W] of the size of an octave.
            octave: the octave, 0 for the whole size.
        """
        return self.statistics.describe(exemplars, octave)

    @override
    def init(self, rng: Generator, count: int) -> Params:
        theta: Params = self.network.init(rng, count)
        return theta

    @abstractmethod
    def generate(self, theta: Params, noise: Tensor, octave: int = 0) -> Any:
        """Generate the pictures or maps [T, B, ...] that errors are of.

        Args:
            theta: fits [T, ...].
            noise: the noise of B pictures of each task, [T, B, C, H, W], of the size of an octave.
            octave: the octave, 0 for the whole size.
        """

    @property
    def noise_channels(self) -> int:
        """The number of channels of noise: the network's, but at least MIN_NOISE_CHANNELS."""
        channels: int = max(self.network.noise, MIN_NOISE_CHANNELS)
        return channels

    def draw_noise(self, rng: Generator, tasks: int, count: int, octave: int = 0) -> Tensor:
        """Draw standard normal noise [tasks, count, C, h, w] of pictures of each task, of the size of an octave."""
        return draw_normal(rng, tasks, count, self.noise_channels, *self.octaves.octave_size(octave))

    def fixed_noise(self, like: Tensor, count: int, octave: int = 0) -> Tensor:
        """Return noise that is equal for all tasks and that no fit draws, [tasks, count, C, h, w].

        Args:
            like: a tensor with one entry a task, on the device that noise is to be on.
            count: the number of pictures of each task.
            octave: the octave whose size pictures have, 0 for the whole size.
        """
        noise = self.draw_noise(Generator(like.device).manual_seed(0), 1, count, octave)
        return noise.expand(len(like), -1, -1, -1, -1)

    def shown_noise(self, like: Tensor, size: tuple[int, int] | None = None) -> Tensor:
        """Return the noise of the picture that is written and shown, [tasks, 1, C, height, width], one for all fits.

        Args:
            like: a tensor with one entry a task, on the device that noise is to be on.
            size: height and width of the picture; None for the exemplar's.
        """
        rng = Generator(like.device).manual_seed(SHOWN_SEED)
        noise = draw_normal(rng, 1, 1, self.noise_channels, *(size or self.octaves.octave_size()))
        return noise.expand(len(like), -1, -1, -1, -1)

    @override
    @torch.no_grad()
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """Measure pictures from noise that no fit draws, equal for all tasks."""
        return self.errors_of(self.generate(theta, self.fixed_noise(tasks.rows, JUDGED_PICTURES)), tasks)

    def errors_of(self, prediction: Any, tasks: Tasks) -> dict[str, Tensor]:
        """Measure pictures or maps that need not come from the network; see :meth:`Statistics.errors`."""
        return self.statistics.errors(prediction, tasks)

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
    def encoder_input(self, tasks: Tasks, rng: Generator) -> Batch:
        return tasks.gather(("summary",))

    @override
    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        x = torch.log(encoder_input["summary"] + 0.01) / 2  # as features are heavy-tailed
        for layer in (1, 2, 3):
            x = x @ encoder[f"mlp{layer}.w"].T + encoder[f"mlp{layer}.b"]
            x = leaky_relu(x, ENCODER_LEAKY_SLOPE) if layer < 3 else x
        return add_decoder({"z": x} | self.select_known(encoder_input), encoder)

    def select_known(self, encoder_input: Batch) -> Params:
        """Select the parameters of fits that the encoder's input holds. The default is none."""
        return {}

    def crop(self, image: Tensor, rng: Generator) -> Tensor:
        """Crop an image [3, S, S] at random to [3, s, s] that could have been photographed as well; here not at all."""
        return image

    @override
    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Crop, flip and transpose the exemplars and permute their channels, at random."""
        count, octave = len(tasks), self.octaves.find_octave(tasks.data)
        is_flipped, is_transposed = draw_uniform(rng, 2, count) < 0.5
        exemplars = []
        for row, *turning in zip(tasks.rows, is_flipped.tolist(), is_transposed.tolist(), strict=True):
            image = self.crop(tasks.data["image"][row].float() / 255, rng)
            exemplars.append(self.octaves.take_exemplar(turn_picture(image, *turning)[None], octave))
        channels = draw_uniform(rng, count, 3).argsort(1)
        images = torch.cat(exemplars)
        images = images.gather(1, channels[..., None, None].expand(images.shape))
        targets = self.make_variant_targets(images, octave)
        changes = PictureChanges(is_flipped, is_transposed, channels)
        return tasks.make_variants(targets | self.change_data(tasks, changes))

    def make_variant_targets(self, exemplars: Tensor, octave: int) -> dict[str, Tensor]:
        """Return the targets of augmented exemplars; see :meth:`make_targets`."""
        return self.make_targets(exemplars, octave)

    def change_data(self, tasks: Tasks, changes: PictureChanges) -> dict[str, Tensor]:
        """Return further data of exemplars whose pictures are changed at random. The default is none.

        Args:
            tasks: the exemplars before that.
            changes: how their pictures are changed.
        """
        return {}


class Quilts(NamedTuple):
    """Quilts of exemplars, with a task axis or without.

    Attributes:
        quilt: the pictures of quilts, display values [T, 3, H, W].
        places: where in the exemplar each cell of a quilt comes from, [T, 2, rows, columns].
    """

    quilt: Tensor
    places: Tensor


class PictureChanges(NamedTuple):
    """Changes of pictures by data augmentation.

    Attributes:
        is_flipped: whether left and right are exchanged, bool [T].
        is_transposed: whether rows and columns are exchanged after that, bool [T].
        channels: the number that each channel had before, [T, 3].
    """

    is_flipped: Tensor
    is_transposed: Tensor
    channels: Tensor


def turn_picture(picture: Tensor, is_flipped: bool, is_transposed: bool) -> Tensor:
    """Flip a picture [..., H, W] from left to right, then exchange rows and columns, each if that is asked for."""
    picture = picture.flip(-1) if is_flipped else picture
    return picture.mT if is_transposed else picture


def move_tiles(tiles: Tensor, noise: Tensor) -> Tensor:
    """Move tiles as noise says, and shrink them to its size.

    Args:
        tiles: pictures or maps that tile, [T, C, H, W]; at a coarse octave those of augmented exemplars are as small.
        noise: the noise of B pictures of each task, [T, B, C', h, w], whose first two numbers say how far down and
            right tiles are moved.

    Returns:
        [T, B, C, h, w].
    """
    shares = torch.special.ndtr(noise[:, :, 0, 0, :2]).expand(len(tiles), -1, -1)
    times = tiles.shape[-1] // noise.shape[-1]
    small_tiles = avg_pool2d(tiles, times) if times > 1 else tiles
    return move_periodically(small_tiles, shares)
