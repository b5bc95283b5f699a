"""Baselines of textures: the nearest training texture, image quilting (Efros & Freeman 2001), and blending.

The quilting of one picture is in `metapp.appearance.quilting`, the blending of one (Heitz & Neyret 2018) in `blending`
beside this module; here they become methods that are fitted and judged. Where fits of textures are pieces of the
photograph itself, both methods write files at the scale and resolution of the photograph, too.
"""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.assets import Texture
from metapp.appearance.features import statistics_distance
from metapp.appearance.lattice import remove_quadratic_trend
from metapp.appearance.quilting import choose_block_size, quilt
from metapp.appearance.stretch import stretch_to_tile
from metapp.apps.exemplar.exemplar_sight import JUDGED_PICTURES, ExemplarSight
from metapp.apps.exemplar.exemplar_statistics import Statistics
from metapp.apps.exemplar.quilts import count_tile_cells, make_piece_source, quilt_places
from metapp.apps.texture import app as texture_app
from metapp.extensions.baselines.baseline import (
    INDEX_NUMBERS_AND_BYTES,
    Baseline,
    BaselineFit,
    CostLimits,
    TrainingTasks,
    tensor_bytes,
)
from metapp.extensions.baselines.blending import blend_tile
from metapp.learning.app import App
from metapp.learning.task import Task, Tasks
from metapp.networks.quilted import fetch_pieces

COMPARISON_BLOCK_TASKS = 8  # training tasks whose Gram matrices are compared at once


def baselines(app: App) -> tuple[Baseline, ...]:
    """Return the baselines of textures, which read no quilts of fits."""
    app = leave_out_quilts(app)
    return NearestExemplar(app), Quilting(app), Blending(app)


def leave_out_quilts(app: App) -> App:
    """Return an application of exemplars for methods that read no quilts: tasks are prepared without any."""
    return replace(app, sight=replace(cast(ExemplarSight, app.sight), candidates=0))


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
        statistics = cast(Statistics, self.app.judge)
        data = training.prepared_tasks.data
        self.grams = {name: data[name] for name in sorted(data) if name.startswith("gram")}
        self.pictures = statistics.octaves.take_exemplar(data["image"].float() / 255)
        self.shared_bytes = tensor_bytes(data["image"], *self.grams.values())

    @override
    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        targets = [tasks.data[name][tasks.rows] for name in self.grams]
        blocks = torch.arange(len(self.pictures)).split(COMPARISON_BLOCK_TASKS)
        errors = [statistics_distance([gram[rows] for gram in self.grams.values()], targets) for rows in blocks]
        nearest = self.pictures[int(torch.cat(errors).reshape(len(self.pictures), -1).mean(1).argmin())]
        texture = Texture(nearest, tiles=False)
        return BaselineFit(
            lambda: nearest[None, None], *INDEX_NUMBERS_AND_BYTES, lambda task, size: texture, texture.preview()
        )


class Quilting(Baseline):
    """Image quilting; a fit stores the exemplar, a byte for each number. Files tile; judged pictures need not.

    Files have the scale of the exemplar or, where fits are pieces of the photograph itself, of the photograph.
    """

    name = "quilting"
    title = "image quilting (Efros & Freeman 2001), blocks of a quarter of the exemplar"
    cannot = "make anything that is no copy of pieces of the exemplar, which it holds"
    is_resizable = True

    @override
    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        app = cast(texture_app.Texture, self.app)
        image = tasks.data["image"][tasks.rows]
        exemplar = app.judge.octaves.take_exemplar(image.float() / 255)[0]
        size = exemplar.shape[1], exemplar.shape[2]
        pictures = quilt_pictures(exemplar, size, rng)

        def make_texture(task: Task, asked_size: tuple[int, int] | None) -> Texture:
            if app.decoder.reads_quilts:
                return Texture(quilt_photo(app.judge.take_even_photo(image[0]), exemplar, asked_size, rng))
            return Texture(quilt_tile(exemplar, asked_size or size, rng))

        picture = Texture(pictures[0, 0]).preview()
        return BaselineFit(lambda: pictures, exemplar.numel(), exemplar.numel(), make_texture, picture)


class Blending(Baseline):
    """Histogram-preserving blending; a fit stores the exemplar, a byte for each number. All pictures tile.

    Files have the scale of the exemplar or, where fits are pieces of the photograph itself, of the photograph.
    """

    name = "blending"
    title = "histogram-preserving blending of random patches of the exemplar (Heitz & Neyret 2018)"
    cannot = "keep structure: bricks and threads dissolve, and only the colours and the grain of the exemplar stay"
    is_resizable = True

    @override
    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        app = cast(texture_app.Texture, self.app)
        image = tasks.data["image"][tasks.rows]
        exemplar = app.judge.octaves.take_exemplar(image.float() / 255)[0]
        even, size = remove_quadratic_trend(exemplar).clamp(0, 1), (exemplar.shape[1], exemplar.shape[2])
        pictures = torch.stack([blend_tile(even, size, rng) for _ in range(JUDGED_PICTURES)])[None]

        def make_texture(task: Task, asked_size: tuple[int, int] | None) -> Texture:
            source = app.judge.take_even_photo(image[0]) if app.decoder.reads_quilts else even
            return Texture(blend_tile(source, asked_size or (source.shape[1], source.shape[2]), rng))

        picture = Texture(pictures[0, 0]).preview()
        return BaselineFit(lambda: pictures, exemplar.numel(), exemplar.numel(), make_texture, picture)


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


def quilt_photo(photo: Tensor, exemplar: Tensor, size: tuple[int, int] | None, rng: Generator) -> Tensor:
    """Quilt a picture that tiles from blocks of a photograph, at the photograph's own scale and resolution.

    Blocks are chosen in the exemplar, the small copy of the photograph, as :func:`quilt_tile` chooses them, and fetched
    from the photograph.

    Args:
        photo: the photograph, [3, S, S'], sRGB in [0, 1], evenly lit.
        exemplar: the copy, [3, H, W], sRGB in [0, 1].
        size: the height and width of the picture in px; None for the photograph's.
        rng: chooses among blocks that agree about as well.

    Returns:
        The picture, [3, *size], sRGB in [0, 1].
    """
    photo_size, cells = (photo.shape[1], photo.shape[2]), (exemplar.shape[1], exemplar.shape[2])
    size = size or photo_size
    tile_cells = count_tile_cells(size, photo_size, cells)
    block = min(min(cells) // 4, min(tile_cells) // 2)  # a block of a tile must not meet itself
    blocks = block, max(1, round(block / 6))
    source = make_piece_source(remove_quadratic_trend(exemplar), tile_cells, stretches=True)
    places = quilt_places(source, tile_cells, blocks, make_numpy_generator(rng), repetition_weight=0.0)
    return fetch_pieces(photo, places, size, cells).clamp(0, 1)


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
    numbers = make_numpy_generator(rng)
    picture = exemplar.permute(1, 2, 0).numpy()
    block = min(choose_block_size(picture)[0], min(size) // 2)  # a block of a tile must not meet itself
    overlap = max(1, round(block / 6))
    phase = None if frequencies is None or not len(frequencies) else frequencies.numpy()
    pictures = [
        quilt(picture, size, numbers, block=block, overlap=overlap, tiles=tiles, frequencies=phase)
        for _ in range(count)
    ]
    return torch.from_numpy(np.stack(pictures)).permute(0, 3, 1, 2)[None]


def make_numpy_generator(rng: Generator) -> np.random.Generator:
    """Make a generator of NumPy whose seed is drawn from a generator of torch."""
    return np.random.default_rng(int(torch.randint(2**31, (), generator=rng)))
