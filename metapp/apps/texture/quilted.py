"""Textures of pieces of the photograph: a quilt that tiles, and a network that corrects its light from place to place.

A fit begins with the error of the best of several quilts, and its steps lower it. The quilt is fetched from the
photograph at the photograph's own resolution, so that structures are as large and as sharp as there.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, interpolate
from typing_extensions import override

from metapp.appearance.order import MIN_LATTICE_SCORE, Lattice, find_lattice, kept_order_share, remove_quadratic_trend
from metapp.appearance.quilting import quilt_pixel_numbers
from metapp.apps.texture.app import Texture
from metapp.learning.task import Batch, Params, Task, Tasks
from metapp.networks.layout import apply_stretch, find_stretch
from metapp.networks.quilted import LightGrid, colour_moments, fetch_pieces, move_periodically, subtract_trend

BLOCKS = ((64, 21), (96, 32), (128, 42), (48, 16))  # side and overlap of blocks, in cells, of which quilts are made
ORDER_GOAL, ORDER_WEIGHT = 0.9, 0.3  # share of the exemplar's order that a quilt should keep; the penalty below it
CHANGE_WEIGHT = 30.0  # weight in the loss of the mean squared change of the quilt, so that it stays unseen
LARGEST_PHOTO_PX = 4096  # side at which photographs are read
MIN_TILE_CELLS = 8  # rows and columns of the smallest tile
TILE_SEED = 7  # seed of quilts of other sizes than the photograph's


@dataclass(frozen=True)
class QuiltedTexture(Texture):
    """Textures of pieces of a photograph that a network corrects.

    Parameters of fits are the network's, and two that tasks determine: `places` [T, 2, rows, columns], the place in the
    photograph of each cell of the quilt, and `quilt` [T, 3, H, W], the quilt at the size of exemplars in fits.

    Attributes:
        network: the grid of corrections.
        candidates: the number of quilts of which a fit begins with the best one.
    """

    network: LightGrid = field()  # type: ignore[assignment]
    candidates: int = 12

    @property
    @override
    def read_size(self) -> int:
        return LARGEST_PHOTO_PX

    @property
    def cells(self) -> tuple[int, int]:
        """The rows and columns of cells that have the size of the photograph: its px at the coarsest size of fits."""
        return self.octaves.octave_size(self.octaves.finer)

    @override
    def init(self, rng: Generator, count: int) -> Params:
        return self.network.init(rng, count)

    @override
    def task_parameters(self, tasks: Tasks) -> Params:
        """Return the quilts."""
        return {name: tasks.data[name][tasks.rows] for name in ("places", "quilt")}

    @override
    def init_encoder(self, rng: Generator) -> Params:
        return self.network.init_encoder(rng)

    @override
    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        """Return the quilts, and `moments` [T, 6], the channels' means and deviations of exemplars."""
        return self.task_parameters(tasks) | {"moments": tasks.data["moments"][tasks.rows]}

    @override
    def encode(self, encoder: Params, condition: Batch) -> Params:
        places, quilt = condition["places"], condition["quilt"]
        return self.network.encode(encoder, quilt, condition["moments"]) | {"places": places, "quilt": quilt}

    @override
    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Crop, flip, transpose and recolour exemplars at random, and quilt each of them once."""
        return super(QuiltedTexture, replace(self, candidates=1)).augment(tasks, rng)

    @override
    def make_targets(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Return the statistics of exemplars [B, 3, H, W], and the quilts that fits of them begin with."""
        targets = self.statistics.describe(exemplars, octave)
        quilts = [self._choose_quilt(exemplar) for exemplar in exemplars]
        places, pictures = (torch.stack(parts) for parts in zip(*quilts, strict=True))
        return targets | {"places": places, "quilt": pictures, "moments": colour_moments(exemplars)}

    @torch.no_grad()
    def _choose_quilt(self, exemplar: Tensor) -> tuple[Tensor, Tensor]:
        """Return the places [2, rows, columns] and the picture [3, H, W] of the best of several quilts of an exemplar.

        The best one has the least error at half the size, and keeps the exemplar's order. Candidates of all sizes of
        blocks are of the stretched exemplar first, then of the exemplar as it is, and so on in turns.
        """
        even, octave = remove_quadratic_trend(exemplar), min(1, self.octaves.count - 1)
        lattice, targets = find_lattice(even), self.statistics.describe(_halve(exemplar[None], octave), octave)
        small = interpolate(even[None], size=self.cells, mode="area")[0]
        sources = [make_piece_source(small, self.cells, stretches=stretches) for stretches in (True, False)]
        best, least = None, float("inf")
        for candidate in range(self.candidates):
            source = sources[candidate // len(BLOCKS) % 2]
            rng = np.random.default_rng(candidate)
            places = quilt_places(source, self.cells, BLOCKS[candidate % len(BLOCKS)], rng)
            size = exemplar.shape[1], exemplar.shape[2]
            picture = fetch_pieces(even, places, size, self.cells).clamp(0, 1)
            error = 0.0
            if self.candidates > 1:
                distance = self.statistics.gram_distance(_halve(picture[None], octave)[None], targets)
                error = float(distance) + order_penalty(lattice, picture)
            if error < least:
                best, least = (places, picture), error
        assert best is not None
        return best

    @override
    def generate(self, theta: Params, noise: Tensor, octave: int = 0) -> Tensor:
        """Generate textures [T, B, 3, H, W], sRGB in [0, 1]: the corrected quilt, moved as the noise says."""
        return self._move_tiles(self.network(theta, theta["quilt"]), noise)

    def _move_tiles(self, tiles: Tensor, noise: Tensor) -> Tensor:
        """Move tiles [T, 3, H, W] as the first numbers of noise [T, B, C, H, W] say: [T, B, 3, H, W]."""
        shares = torch.special.ndtr(noise[:, :, 0, 0, :2]).expand(len(tiles), -1, -1)
        return move_periodically(tiles, shares)

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Add the quilts to what textures have: steps change none, whatever else a fit's parameters are."""
        return super().sample(tasks, rng, count) | {"quilt": tasks.data["quilt"][tasks.rows]}

    @override
    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Return the relative L1 distance of Gram matrices, [T], plus CHANGE_WEIGHT times the squared change."""
        tiles = self.network(theta, batch["quilt"])
        change = (tiles - batch["quilt"].clamp(0, 1)).square().mean((-1, -2, -3))
        pictures = self._move_tiles(tiles, batch["noise"])
        return self.statistics.gram_distance(pictures, batch) + CHANGE_WEIGHT * change

    @override
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        return super().errors(theta | self.task_parameters(tasks), tasks)

    def take_even_photo(self, image: Tensor) -> Tensor:
        """Return a photograph as floats [3, S, S], display values in [0, 1], without its slow change of light.

        Args:
            image: the photograph, uint8 [3, S, S].
        """
        photo = image.float() / 255
        exemplar = self.octaves.take_exemplar(photo[None])[0]
        return subtract_trend(photo, exemplar, remove_quadratic_trend(exemplar))

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
        quilt = theta["quilt"]
        if "image" in task.data:
            photo = self.take_even_photo(task.data["image"])
            photo_size = photo.shape[1], photo.shape[2]
            quilt = fetch_pieces(photo, theta["places"][0], photo_size, self.cells)[None]
        else:
            warnings.warn(
                f"{task.name}: its photo is not at hand, expected for the photo's resolution; the texture has "
                f"{quilt.shape[-1]} px a side. Fit the photo again.",
                stacklevel=2,
            )
        tile = self.network(theta, quilt)[0]
        own_size = tile.shape[1], tile.shape[2]
        if size is None or size == own_size:
            return tile
        small_tile = interpolate(self.network(theta, theta["quilt"]), size=self.cells, mode="area")[0]
        tile_cells = count_tile_cells(size, own_size, self.cells)
        rng = np.random.default_rng(TILE_SEED)
        holds_whole_tiles = all(length % own == 0 for length, own in zip(size, own_size, strict=True))
        source = make_piece_source(small_tile, tile_cells, stretches=not holds_whole_tiles)
        places = quilt_places(source, tile_cells, BLOCKS[1], rng)
        return fetch_pieces(tile, places, size, self.cells).clamp(0, 1)


def _halve(pictures: Tensor, times: int) -> Tensor:
    """Halve the sides of pictures [B, 3, H, W] so many times."""
    return avg_pool2d(pictures, 2**times) if times else pictures


def order_penalty(lattice: Lattice, picture: Tensor) -> float:
    """Return the penalty on a picture that has lost a part of an exemplar's order; 0 if the exemplar has none."""
    if lattice.score <= MIN_LATTICE_SCORE:
        return 0.0
    return ORDER_WEIGHT * max(0.0, ORDER_GOAL - kept_order_share(lattice, picture))


def count_tile_cells(size: tuple[int, int], photo_size: tuple[int, int], cells: tuple[int, int]) -> tuple[int, int]:
    """Count the rows and columns of cells of a tile in which structures are as large as in the photograph.

    Args:
        size: the height and width of the tile in px.
        photo_size: the height and width of the photograph in px.
        cells: the rows and columns of cells that have the size of the whole photograph.
    """
    rows, columns = (
        max(MIN_TILE_CELLS, round(length * count / photo_length))
        for length, count, photo_length in zip(size, cells, photo_size, strict=True)
    )
    return rows, columns


class PieceSource(NamedTuple):
    """The picture that pieces of a tile are taken from.

    Attributes:
        pixels: the picture, [3, h, w].
        places: the place (y, x) of the centre of each px in the exemplar, in its sides, [2, h, w].
        frequencies: the frequencies of its lattice in cycles per px, with which all pieces are in phase, or None.
    """

    pixels: Tensor
    places: Tensor
    frequencies: NDArray[np.floating] | None = None


def make_piece_source(exemplar: Tensor, cells: tuple[int, int], *, stretches: bool) -> PieceSource:
    """Make the source of the pieces of a tile.

    Args:
        exemplar: an evenly lit picture, [3, H, W].
        cells: the rows and columns of the tile, in px of the exemplar.
        stretches: whether an exemplar with a strong lattice is stretched, so that the tile holds whole periods of it.
    """
    places = torch.stack(
        torch.meshgrid(*((torch.arange(side) + 0.5) / side for side in exemplar.shape[1:]), indexing="ij")
    ).to(exemplar)
    change, frequencies = find_stretch(exemplar, cells) if stretches else (None, None)
    if change is None or frequencies is None:
        return PieceSource(exemplar, places)
    return PieceSource(apply_stretch(exemplar, change), apply_stretch(places, change), frequencies.numpy())


def quilt_places(
    source: PieceSource, cells: tuple[int, int], blocks: tuple[int, int], rng: np.random.Generator
) -> Tensor:
    """Quilt a tile of an exemplar, and return where its cells come from.

    Args:
        source: the source of pieces.
        cells: the rows and columns of the tile, in px of the source.
        blocks: the side and the overlap of blocks in px.
        rng: chooses among blocks that agree about as well.

    Returns:
        The place (y, x) of the centre of each cell in the exemplar, in its sides, [2, rows, columns].
    """
    block = min(blocks[0], *source.pixels.shape[1:], *cells)
    numbers = quilt_pixel_numbers(
        source.pixels.permute(1, 2, 0).cpu().numpy(),
        cells,
        rng,
        block=block,
        overlap=max(1, min(blocks[1], block // 3)),
        tiles=True,
        frequencies=source.frequencies,
    )
    result: Tensor = source.places.flatten(1)[:, torch.from_numpy(numbers)]
    return result
