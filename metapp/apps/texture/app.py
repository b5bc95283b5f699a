"""The application of textures: Gram matrices of features of generated pictures are fitted to an exemplar's.

Where decoders read quilts, a texture is made of pieces of the photograph, which are fetched at the photograph's own
resolution, so that structures are as large and as sharp as there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Generator, Tensor
from torch.nn.functional import interpolate
from typing_extensions import override

from metapp.appearance.features import gram, statistics_distance
from metapp.appearance.lattice import remove_quadratic_trend
from metapp.apps.exemplar.exemplar_codec import LARGEST_PHOTO_PX, SummaryEncoder
from metapp.apps.exemplar.exemplar_sight import ExemplarSight
from metapp.apps.exemplar.exemplar_statistics import Statistics
from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.texture.texture_codec import LightEncoder, TextureAnswer, TextureDecoder
from metapp.learning.app import App, ErrorMeasure
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec
from metapp.networks.quilted import colour_moments, subtract_trend

CHANGE_WEIGHT = 30.0  # weight in the loss of the mean squared change of the quilt, so that it stays unseen
MIN_CROP_SHARE = 0.5  # shortest side of random crops over the side of the exemplar


class GramStatistics(Statistics):
    """Statistics of exemplars by Gram matrices of features, means over the whole picture."""

    reduced_precision = True

    @override
    @torch.no_grad()
    def describe(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Compute the Gram matrix [B, C, C] of each feature map, `gram0`, `gram1` and so on, and what encoders read.

        These are `summary` [B, S], and `moments` [B, 6], the channels' means and deviations.
        """
        maps = self.compute_features(exemplars, octave)
        grams = {f"gram{i}": gram(features) for i, features in enumerate(maps)}
        return grams | {"summary": self.summarise(maps, octave), "moments": colour_moments(exemplars)}

    @override
    def targets(self, tasks: Tasks, rng: Generator | None = None) -> Batch:
        """Return the exemplars' Gram matrices, [T, C, C] each; nothing is drawn."""
        return tasks.gather([name for name in tasks.data if name.startswith("gram")])

    @override
    def take_even_photo(self, image: Tensor) -> Tensor:
        photo = image.float() / 255
        exemplar = self.octaves.take_exemplar(photo[None])[0]
        return subtract_trend(photo, exemplar, remove_quadratic_trend(exemplar))

    def gram_distance(self, pictures: Tensor, described: Batch) -> Tensor:
        """Return the relative L1 distance of pictures' Gram matrices from the exemplars', [T].

        Args:
            pictures: pictures [T, B, 3, H, W] of an octave's size, sRGB in [0, 1].
            described: what :meth:`targets` returns.
        """
        maps = self.compute_features(pictures.flatten(0, 1), self.octaves.find_octave(described))
        grams = [gram(features).unflatten(0, pictures.shape[:2]) for features in maps]
        return statistics_distance(grams, [described[f"gram{i}"][:, None] for i in range(len(maps))]).mean(1)

    @override
    def loss(self, answer: TextureAnswer, described: Batch) -> Tensor:
        """Return the relative L1 distance of Gram matrices, [T], plus CHANGE_WEIGHT times the change of quilts."""
        distance = self.gram_distance(answer.prediction, described)
        return distance if answer.quilt_change is None else distance + CHANGE_WEIGHT * answer.quilt_change

    @override
    @torch.no_grad()
    def errors(self, prediction: Tensor, seen: Batch, truth: Batch) -> dict[str, Tensor]:
        """Measure pictures [T, B, 3, H, W] of the exemplar's size, sRGB in [0, 1], by Gram matrices: `error` [T]."""
        return {"error": self.gram_distance(prediction, seen)}


@dataclass(frozen=True)
class Texture(App):
    """The application of textures: a task is one exemplar of a stationary texture."""

    decoder: TextureDecoder
    sight: ExemplarSight
    judge: GramStatistics

    name = "texture"
    error_measure = ErrorMeasure("relative L1 distance of Gram matrices, mean over taps and generated textures")
    tensors: ClassVar = {"image": TensorSpec((3, "S", "S"), "uint8")}

    @property
    @override
    def read_size(self) -> int:
        return LARGEST_PHOTO_PX if self.decoder.reads_quilts else 0

    @override
    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        return self.sight.vary(tasks, rng)

    def take_file_exemplar(self, task: Task) -> Tensor:
        """Return the exemplar [3, H, W], sRGB in [0, 1], in which structures are as large as in files."""
        return task.data["image"].float() / 255 if self.decoder.reads_quilts else self.sight.take_exemplar(task)[0]

    @torch.no_grad()
    def draw_tile(self, theta: Params, task: Task, size: tuple[int, int] | None) -> Tensor:
        """Draw the texture of a fit for a file; it tiles.

        Args:
            theta: a fit, with a task axis of length 1.
            task: the task that was fitted.
            size: height and width in px; None for the usual size. With quilts this is the photograph's, or, if the task
                holds no photograph, the quilt's, and a warning says so. For other sizes the tile is quilted once more.

        Returns:
            The texture [3, H, W], sRGB in [0, 1].
        """
        decoder = self.decoder
        if not decoder.reads_quilts:
            return decoder.generate(theta, decoder.shown_noise(theta["z"], decoder.file_size(size))).prediction[0, 0]
        tile: Tensor = decoder.network(theta, self.sight.fetch_quilt(theta, task, "the texture has"))[0]
        if size is None or size == (tile.shape[1], tile.shape[2]):
            return tile
        colours = interpolate(decoder.network(theta, theta["quilt"]), decoder.octaves.octave_size(), mode="area")[0]
        return self.sight.resize_tile(task, tile, colours, size).clamp(0, 1)


def compose_texture(network: Any, octaves: Octaves, candidates: int = 0) -> Texture:
    """Compose the application of textures.

    Args:
        network: the network.
        octaves: the sizes at which pictures are compared with the exemplar.
        candidates: the number of quilts of which a fit begins with the best one; 0 for textures from noise.
    """
    decoder, statistics = TextureDecoder(network, octaves, candidates > 0), GramStatistics(octaves)
    sight = ExemplarSight(statistics, decoder.noise_channels, candidates, MIN_CROP_SHARE)
    return Texture(decoder, sight, statistics, (LightEncoder if candidates else SummaryEncoder)(statistics))
