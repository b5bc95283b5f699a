"""The decoder of pictures that look like an exemplar, and General's encoder of the exemplar.

The decoder is a network that generates pictures from noise or from a quilt. Textures and stationary svBRDFs say by
subclasses what the network's output is. Networks are in :mod:`metapp.networks`.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, leaky_relu
from typing_extensions import override

from metapp.appearance.features import feature_conditions
from metapp.apps.exemplar.exemplar_statistics import Statistics
from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.exemplar.quilts import QUILT_NAMES, select_quilts
from metapp.learning.components import Decoder, Encoder
from metapp.learning.random_tensors import draw_normal
from metapp.learning.task import Batch, Params
from metapp.networks.coded import add_decoder, join_encoder
from metapp.networks.quilted import move_periodically

# Channels of noise, at least, drawn even if the network reads none: the first two numbers of the first channel say how
# far down and right tiles are moved
MIN_NOISE_CHANNELS = 2
JUDGED_SEED, SHOWN_SEED = 0, 1  # seeds of the noise of pictures that are judged, and that are written and shown
FILE_SIDE_TIMES = 4  # side of a picture in files over its side in training
HIDDEN_UNITS = 128  # units of each hidden layer of the encoder
LEAKY_SLOPE = 0.2  # slope below 0 of the leaky ReLUs of the encoder
LARGEST_PHOTO_PX = 4096  # side at which photographs are read, of which pieces are fetched

Answer = TypeVar("Answer")


@dataclass(frozen=True)
class ExemplarDecoder(Decoder[Answer, Batch]):
    """A network that generates pictures or maps of an exemplar's size.

    Fits of quilts have two parameters that the exemplar determines: `places` [T, 2, rows, columns], where in it each
    cell of the quilt comes from, and `quilt` [T, 3, H, W], its picture. No step changes them. Noise says how far a
    quilt is moved, and nothing else unless the network reads noise, too.

    Attributes:
        network: the network.
        octaves: the sizes at which pictures are compared with the exemplar. A quilt has as many cells as pictures have
            px.
        reads_quilts: whether the network changes a quilt of the exemplar: a picture of pieces that tile.
    """

    network: Any
    octaves: Octaves
    reads_quilts: bool = False

    def __post_init__(self) -> None:
        # places are in sides of the exemplar, and are applied to the whole square photograph
        height, width = self.octaves.octave_size()
        if self.reads_quilts and height != width:
            raise ValueError(f"exemplars of {height}x{width}, expected square ones for quilts.")

    @property
    def noise_channels(self) -> int:
        """The number of channels of noise: the network's, but at least MIN_NOISE_CHANNELS."""
        return max(int(self.network.noise), MIN_NOISE_CHANNELS)

    @property
    def file_side_step(self) -> int:
        """The number of px of which sides of files are multiples; quilts are quilted again for files of any size."""
        return 1 if self.reads_quilts else int(self.network.side_step)

    def file_size(self, size: tuple[int, int] | None) -> tuple[int, int]:
        """Return the height and width of files, in px: as asked for, else FILE_SIDE_TIMES the exemplar's."""
        height, width = self.octaves.octave_size()
        return size or (FILE_SIDE_TIMES * height, FILE_SIDE_TIMES * width)

    def shown_noise(self, like: Tensor, size: tuple[int, int] | None = None) -> Tensor:
        """Return the noise of the picture that is written and shown, [T, 1, C, height, width], one for all fits.

        Args:
            like: a tensor with one entry a task, on the device that noise is to be on.
            size: height and width of the picture; None for the exemplar's.
        """
        size = size or self.octaves.octave_size()
        return fixed_noise(like, (1, self.noise_channels, *size), SHOWN_SEED)

    @override
    def init(self, rng: Generator, count: int) -> Params:
        theta: Params = self.network.init(rng, count)
        return theta

    @override
    def __call__(self, theta: Params, seen: Batch) -> Answer:
        # theta_0 of Meta has no quilt without an encoder
        return self.generate(theta | select_quilts(seen), seen["noise"], self.octaves.find_octave(seen))

    @abstractmethod
    def generate(self, theta: Params, noise: Tensor, octave: int = 0) -> Answer:
        """Generate the pictures or maps [T, B, ...] that errors are of.

        Args:
            theta: fits [T, ...].
            noise: the noise of B pictures of each task, [T, B, C, H, W], of the size of an octave; of octave 0, it may
                have the size of files.
            octave: the octave, 0 for the whole size.
        """


@dataclass(frozen=True)
class SummaryEncoder(Encoder[Batch]):
    """A network from `summary` [T, S] to the code z; the generator's other parameters are equal for all tasks.

    Attributes:
        statistics: the statistics that summarise exemplars.
        input_names: the names of the encoder's input. Quilts, if there are any, become parameters as they are.
    """

    statistics: Statistics
    input_names: ClassVar[tuple[str, ...]] = ("summary", *QUILT_NAMES)

    @override
    def recorded_conditions(self, device: torch.device | None = None) -> dict[str, str]:
        return feature_conditions(device if self.statistics.reduced_precision else None)

    @override
    def init(self, rng: Generator, decoder: Any) -> Params:
        encoder = join_encoder({}, decoder.network.init(rng, 1), ("z",))
        widths = (self.statistics.summary_size, HIDDEN_UNITS, HIDDEN_UNITS, decoder.network.code)
        for layer in (1, 2, 3):
            inputs, outputs = widths[layer - 1], widths[layer]
            weights = draw_normal(rng, outputs, inputs)
            encoder[f"mlp{layer}.w"] = weights * math.sqrt(2 / inputs)
            encoder[f"mlp{layer}.b"] = torch.zeros(outputs, device=rng.device)
        return encoder

    @override
    def select_input(self, seen: Batch) -> Batch:
        return {name: seen[name] for name in self.input_names if name in seen}

    @override
    def __call__(self, encoder: Params, encoder_input: Batch, decoder: Any) -> Params:
        x = torch.log(encoder_input["summary"] + 0.01) / 2  # as features are heavy-tailed
        for layer in (1, 2, 3):
            x = x @ encoder[f"mlp{layer}.w"].T + encoder[f"mlp{layer}.b"]
            x = leaky_relu(x, LEAKY_SLOPE) if layer < 3 else x
        return add_decoder({"z": x} | select_quilts(encoder_input), encoder)


def fixed_noise(like: Tensor, shape: tuple[int, ...], seed: int) -> Tensor:
    """Return standard normal noise [T, *shape] that is equal for all tasks and that no fit draws.

    Args:
        like: a tensor with one entry a task, on the device that noise is to be on.
        shape: the number of pictures of each task and of channels, and the height and width of the noise.
        seed: the seed, which tells noises for several purposes apart.
    """
    noise = draw_normal(Generator(like.device).manual_seed(seed), 1, *shape)
    return noise.expand(len(like), *shape)


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
