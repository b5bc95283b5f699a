"""Textures of pieces of the photograph: a quilt that tiles, and a network that corrects its light from place to place.

A fit begins with the error of the best of several quilts, and its steps lower it. The quilt is fetched from the
photograph at the photograph's own resolution, so that structures are as large and as sharp as there.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Generator, Tensor
from torch.nn.functional import interpolate
from typing_extensions import override

from metapp.appearance.lattice import remove_quadratic_trend
from metapp.apps.exemplar.app import move_tiles
from metapp.apps.exemplar.quilted_app import QuiltedExemplarApp
from metapp.apps.texture.app import Texture
from metapp.learning.task import Batch, Params, Task, Tasks
from metapp.networks.quilted import LightGrid, colour_moments, subtract_trend

CHANGE_WEIGHT = 30.0  # weight in the loss of the mean squared change of the quilt, so that it stays unseen


@dataclass(frozen=True)
class QuiltedTexture(QuiltedExemplarApp, Texture):
    """Textures of pieces of a photograph that a network corrects.

    Attributes:
        network: the grid of corrections.
    """

    network: LightGrid = field()

    @property
    @override
    def is_periodic(self) -> bool:
        return self.network.periodic

    @override
    def init_encoder(self, rng: Generator) -> Params:
        return self.network.init_encoder(rng)

    @override
    def encoder_input(self, tasks: Tasks, rng: Generator) -> Batch:
        """Return the quilts, and `moments` [T, 6], the channels' means and deviations of exemplars."""
        return self.task_parameters(tasks) | {"moments": tasks.data["moments"][tasks.rows]}

    @override
    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        places, quilt = encoder_input["places"], encoder_input["quilt"]
        return self.network.encode(encoder, quilt, encoder_input["moments"]) | {"places": places, "quilt": quilt}

    @override
    def make_targets(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Add `moments` [B, 6], the channels' means and deviations of exemplars."""
        return super().make_targets(exemplars, octave) | {"moments": colour_moments(exemplars)}

    @override
    def generate(self, theta: Params, noise: Tensor, octave: int = 0) -> Tensor:
        """Generate textures [T, B, 3, H, W], sRGB in [0, 1]: the corrected quilt, moved as the noise says."""
        return move_tiles(self.network(theta, theta["quilt"]), noise)

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Add the quilts. The loss reads them here, since theta_0 of Meta has none without an encoder."""
        return super().sample(tasks, rng, count) | {"quilt": tasks.data["quilt"][tasks.rows]}

    @override
    def loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the relative L1 distance of Gram matrices, [T], plus CHANGE_WEIGHT times the squared change."""
        tiles = self.network(theta, batch["quilt"])
        change = (tiles - batch["quilt"].clamp(0, 1)).square().mean((-1, -2, -3))
        pictures = move_tiles(tiles, batch["noise"])
        return self.statistics.gram_distance(pictures, batch) + CHANGE_WEIGHT * change

    @override
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        return super().errors(theta | self.task_parameters(tasks), tasks)

    @override
    def take_even_photo(self, image: Tensor) -> Tensor:
        """Return a photograph without its slow change of light; see the base class."""
        photo = image.float() / 255
        exemplar = self.octaves.take_exemplar(photo[None])[0]
        return subtract_trend(photo, exemplar, remove_quadratic_trend(exemplar))

    @override
    def take_file_exemplar(self, task: Task) -> Tensor:
        return task.data["image"].float() / 255

    @override
    @torch.no_grad()
    def draw_tile(self, theta: Params, task: Task, size: tuple[int, int] | None) -> Tensor:
        """Fetch the texture of a fit from its photograph; it tiles.

        Args:
            theta: a fit, with a task axis of length 1.
            task: the task that was fitted.
            size: height and width in px, for which the tile is quilted once more; None for the photograph's. If the
                task holds no photograph, the tile has the size of the quilt in the fit, and a warning says so.

        Returns:
            The texture [3, *size], sRGB in [0, 1].
        """
        tile = self.network(theta, self.fetch_quilt(theta, task, "the texture has"))[0]
        own_size = tile.shape[1], tile.shape[2]
        if size is None or size == own_size:
            return tile
        small_tile = interpolate(self.network(theta, theta["quilt"]), size=self.cells, mode="area")[0]
        return self.resize_tile_of_fit(task, tile, small_tile, size).clamp(0, 1)
