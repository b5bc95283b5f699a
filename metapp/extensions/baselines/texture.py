"""Baselines of textures: the nearest training texture, and image quilting (Efros & Freeman 2001).

The quilting of one picture is in `metapp.appearance.quilting`; here it becomes a method that is fitted and judged.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.features import statistics_distance
from metapp.appearance.order import remove_quadratic_trend
from metapp.appearance.quilting import choose_block_size, quilt
from metapp.apps.exemplar.app import JUDGED_PICTURES, ExemplarApp
from metapp.extensions.baselines.baseline import (
    INDEX_NUMBERS_AND_BYTES,
    Baseline,
    BaselineFit,
    CostLimits,
    TrainingTasks,
    tensor_bytes,
)
from metapp.learning.app import App
from metapp.learning.task import Tasks
from metapp.networks.layout import stretch_to_tile

COMPARISON_BLOCK_TASKS = 8  # training tasks whose Gram matrices are compared at once


def baselines(app: App) -> tuple[Baseline, ...]:
    """Return the baselines of textures."""
    return NearestExemplar(app), Quilting(app)


class NearestExemplar(Baseline):
    """The training exemplar with the least error; a fit is its index.

    All tasks share the training exemplars and their Gram matrices.
    """

    name = "nearest"
    title = "the training texture with the least error"
    cannot = "be a texture that is not in its set, nor make more of it"
    learns = True

    @override
    def prepare(self, training: TrainingTasks, allowed: CostLimits) -> None:
        assert isinstance(self.app, ExemplarApp)
        data = training.prepared_tasks.data
        self.grams = {name: data[name] for name in sorted(data) if name.startswith("gram")}
        self.pictures = self.app.octaves.take_exemplar(data["image"].float() / 255)
        self.shared_bytes = tensor_bytes(data["image"], *self.grams.values())

    @override
    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        targets = [tasks.data[name][tasks.rows] for name in self.grams]
        blocks = torch.arange(len(self.pictures)).split(COMPARISON_BLOCK_TASKS)
        errors = [statistics_distance([gram[rows] for gram in self.grams.values()], targets) for rows in blocks]
        nearest = self.pictures[int(torch.cat(errors).reshape(len(self.pictures), -1).mean(1).argmin())]
        return BaselineFit(
            lambda: nearest[None, None], *INDEX_NUMBERS_AND_BYTES, picture=srgb_to_linear_picture(nearest)
        )


class Quilting(Baseline):
    """Image quilting; a fit stores the exemplar, a byte for each number. Files tile; judged pictures need not."""

    name = "quilting"
    title = "image quilting (Efros & Freeman 2001), blocks of a quarter of the exemplar"
    cannot = "make anything that is no copy of pieces of the exemplar, which it holds"
    is_resizable = True

    @override
    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        app = self.app
        assert isinstance(app, ExemplarApp)
        exemplar = app.octaves.take_exemplar(tasks.data["image"][tasks.rows].float() / 255)[0]
        size = exemplar.shape[1], exemplar.shape[2]
        pictures, exemplar_numbers = quilt_pictures(exemplar, size, rng), exemplar.numel()

        def answer_at_size(asked_size: tuple[int, int] | None) -> Tensor:
            return quilt_tile(exemplar, asked_size or size, rng)[None, None]

        return BaselineFit(
            lambda: pictures,
            exemplar_numbers,
            exemplar_numbers,
            picture=srgb_to_linear_picture(pictures[0, 0]),
            answer_at_size=answer_at_size,
        )


def srgb_to_linear_picture(srgb: Tensor) -> Tensor:
    """Return a picture in linear RGB [H, W, 3], of sRGB values [3, H, W] in [0, 1]."""
    return srgb_to_linear(srgb).permute(1, 2, 0)


def quilt_tile(exemplar: Tensor, size: tuple[int, int], rng: Generator) -> Tensor:
    """Quilt a picture that tiles from blocks of an exemplar.

    The exemplar loses its slow changes of brightness, which would show as a band wherever two blocks meet. A strong
    lattice is stretched so that the tile holds whole periods of it, and blocks are in phase with it.

    Args:
        exemplar: the source of all blocks, [3, H, W], sRGB in [0, 1].
        size: the height and width of the picture in px.
        rng: chooses among blocks that agree about as well.

    Returns:
        The picture, [3, *size], sRGB in [0, 1].
    """
    source, frequencies = stretch_to_tile(remove_quadratic_trend(exemplar).clamp(0, 1), size)
    return quilt_pictures(source, size, rng, tiles=True, count=1, frequencies=frequencies)[0, 0]


def quilt_pictures(
    exemplar: Tensor,
    size: tuple[int, int],
    rng: Generator,
    *,
    tiles: bool = False,
    count: int = JUDGED_PICTURES,
    frequencies: Tensor | None = None,
) -> Tensor:
    """Quilt pictures from blocks of an exemplar, which are cut where they overlap and agree most.

    Args:
        exemplar: the source of all blocks, [C, H, W].
        size: the height and width of a picture in px.
        rng: chooses among blocks that agree about as well.
        tiles: whether blocks agree across the edges of a picture, too.
        count: the number of pictures.
        frequencies: the frequencies of the exemplar's lattice, [0 to 2, 2] (y, x) in cycles per px, with which all
            blocks are in phase.

    Returns:
        The pictures, [1, count, C, *size].
    """
    numbers = np.random.default_rng(int(torch.randint(2**31, (), generator=rng)))
    picture = exemplar.permute(1, 2, 0).numpy()
    block = min(choose_block_size(picture)[0], min(size) // 2)  # a block of a tile must not meet itself
    overlap = max(1, round(block / 6))
    phase = None if frequencies is None or not len(frequencies) else frequencies.numpy()
    pictures = [
        quilt(picture, size, numbers, block=block, overlap=overlap, tiles=tiles, frequencies=phase)
        for _ in range(count)
    ]
    return torch.from_numpy(np.stack(pictures)).permute(0, 3, 1, 2)[None]
