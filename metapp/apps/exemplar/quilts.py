"""Quilts: pictures of pieces of an exemplar that tile, kept as the place in the exemplar that each cell comes from.

By the places, anything that lies over the exemplar can be fetched at any resolution: the photograph itself, or maps.
Fits begin at the best of several quilts.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

from metapp.appearance.features import gram, statistics_distance
from metapp.appearance.lattice import Lattice, find_lattice, kept_order_share, remove_quadratic_trend
from metapp.appearance.quilting import quilt_pixel_numbers
from metapp.appearance.stretch import apply_stretch, find_stretch
from metapp.apps.exemplar.exemplar_statistics import Statistics
from metapp.networks.quilted import fetch_pieces, repeated_share, seam_strength

# Names of what a quilt is kept as: parameters of fits that the exemplar determines and no step changes
QUILT_NAMES = ("places", "quilt")
BLOCKS = ((64, 21), (96, 32), (128, 42), (48, 16))  # side and overlap of blocks, in cells, of which quilts are made
BLOCK_CELLS = 256  # cells along a side of the photograph for which these blocks were chosen
ORDER_GOAL, ORDER_WEIGHT = 0.9, 0.3  # share of the exemplar's order that a quilt should keep; the penalty below it
# weight of a quilt's largest repetition, and of the excess of its changes across cuts, beside its error
REPEATED_SHARE_WEIGHT, SEAM_EXCESS_WEIGHT = 0.1, 0.1
AVOIDED_SHARE_WEIGHT = 1.0  # weight of the share of a quilt that shows px to be avoided, beside its error
BLOCK_REPETITION_WEIGHT = 4.0  # factor of the shown share of a block; see :func:`quilt_pixel_numbers`
MIN_TILE_CELLS = 8  # rows and columns of the smallest tile
TILE_CANDIDATES = 6  # quilts of another size than the photograph's, of which the one that keeps most order is taken
# Share of a photograph's order below which a tile of another size has cut it
MIN_ORDER_SHARE_AGAIN = 0.77
TILE_SEED = 7  # seed of quilts of other sizes than the photograph's


def select_quilts(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Select `places` and `quilt` among tensors [T, ...] by name; none if these are not of quilts."""
    return {name: tensors[name] for name in QUILT_NAMES if name in tensors}


class PieceSource(NamedTuple):
    """The picture that pieces of a tile are taken from.

    Attributes:
        pixels: the picture, [3, h, w].
        places: the place (y, x) of the centre of each px in the exemplar, in its sides, [2, h, w].
        frequencies: the frequencies of its lattice in cycles per px, with which all pieces are in phase, or None.
        avoided: the px that pieces show only if nothing else fits, bool [h, w], or None.
    """

    pixels: Tensor
    places: Tensor
    frequencies: NDArray[np.floating] | None = None
    avoided: Tensor | None = None


def make_piece_source(
    exemplar: Tensor, cells: tuple[int, int], *, stretches: bool, avoided: Tensor | None = None
) -> PieceSource:
    """Make the source of the pieces of a tile.

    Args:
        exemplar: an evenly lit picture, [3, H, W].
        cells: the rows and columns of the tile, in px of the exemplar.
        stretches: whether an exemplar with a strong lattice is stretched, so that the tile holds whole periods of it.
        avoided: the px that pieces show only if nothing else fits, bool [H, W]; None for none.
    """
    places = torch.stack(
        torch.meshgrid(*((torch.arange(side) + 0.5) / side for side in exemplar.shape[1:]), indexing="ij")
    ).to(exemplar)
    change, frequencies = find_stretch(exemplar, cells) if stretches else (None, None)
    if change is None or frequencies is None:
        return PieceSource(exemplar, places, avoided=avoided)
    stretched_avoided = None if avoided is None else apply_stretch(avoided[None].to(exemplar), change)[0] > 0.5
    pixels, stretched_places = apply_stretch(exemplar, change), apply_stretch(places, change)
    return PieceSource(pixels, stretched_places, frequencies.numpy(), stretched_avoided)


def quilt_places(
    source: PieceSource,
    cells: tuple[int, int],
    blocks: tuple[int, int],
    rng: np.random.Generator,
    *,
    repetition_weight: float = BLOCK_REPETITION_WEIGHT,
) -> Tensor:
    """Quilt a tile of an exemplar, and return where its cells come from.

    Args:
        source: the source of pieces.
        cells: the rows and columns of the tile, in px of the source.
        blocks: the side and the overlap of blocks in px.
        rng: chooses among blocks that agree about as well.
        repetition_weight: the factor by which blocks that the tile shows already count as worse; 0 as published.

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
        repetition_weight=repetition_weight,
        avoided=None if source.avoided is None else source.avoided.cpu().numpy(),
    )
    result: Tensor = source.places.flatten(1)[:, torch.from_numpy(numbers)]
    return result


@torch.no_grad()
def choose_quilt(
    exemplar: Tensor,
    even: Tensor,
    cells: tuple[int, int],
    statistics: Statistics,
    candidates: int,
    avoided: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Make quilts of an exemplar and return the best.

    It looks most like the exemplar, by the relative distance of Gram matrices at half the size, keeps its order,
    repeats little, and changes across its cuts as the exemplar does. Candidates of all sizes of blocks are of the
    stretched exemplar first, then of the exemplar as it is, and so on in turns.

    Args:
        exemplar: the picture that quilts are to look like, display values [3, H, W].
        even: the exemplar without slow changes of light, of which quilts are made, [3, H, W].
        cells: the rows and columns of cells of a quilt.
        statistics: the statistics whose features are compared.
        candidates: the number of quilts.
        avoided: the exemplar's px that pieces show only if nothing else fits, bool [H, W]; None for none.

    Returns:
        The places [2, rows, columns] and the picture [3, H, W] of the best quilt.
    """
    lattice, size = find_lattice(even), (exemplar.shape[1], exemplar.shape[2])
    small = interpolate(even[None], size=cells, mode="area")[0]
    if avoided is not None:
        avoided = interpolate(avoided[None, None].float(), size=cells, mode="area")[0, 0] > 0.5
    sources = [make_piece_source(small, cells, stretches=stretches, avoided=avoided) for stretches in (True, False)]
    repetition_weight = find_repetition_weight(lattice)

    def quilt(candidate: int) -> tuple[Tensor, Tensor]:
        """Return the places and the picture of a quilt."""
        source, blocks = sources[candidate // len(BLOCKS) % 2], BLOCKS[candidate % len(BLOCKS)]
        rng = np.random.default_rng(candidate)
        places = quilt_places(source, cells, blocks, rng, repetition_weight=repetition_weight)
        return places, fetch_pieces(even, places, size, cells).clamp(0, 1)

    if candidates == 1:
        return quilt(0)
    octave = min(1, statistics.octaves.count - 1)

    def compute_grams(picture: Tensor) -> list[Tensor]:
        small_picture = avg_pool2d(picture[None], 2**octave) if octave else picture[None]
        return [gram(features) for features in statistics.compute_features(small_picture, octave)]

    exemplar_grams, quilts = compute_grams(exemplar), []
    for candidate in range(candidates):
        places, picture = quilt(candidate)
        cost = float(statistics_distance(compute_grams(picture), exemplar_grams))
        cost += ORDER_WEIGHT * lost_order(lattice, picture, ORDER_GOAL) + repetition_penalty(lattice, places, cells)
        if avoided is not None:
            y, x = ((place * count).long().clamp(0, count - 1) for place, count in zip(places, cells, strict=True))
            cost += AVOIDED_SHARE_WEIGHT * float(avoided[y, x].float().mean())
        quilts.append((cost, candidate, places, picture))
    quilts.sort()  # seams, which take the longest, are measured of quilts alone that may still be the best
    best, least = quilts[0][2:], float("inf")
    for cost, _, places, picture in quilts:
        if cost >= least:
            break
        whole_cost = cost + SEAM_EXCESS_WEIGHT * max(0.0, seam_strength(even, picture, places, cells) - 1)
        if whole_cost < least:
            best, least = (places, picture), whole_cost
    return best


def find_repetition_weight(lattice: Lattice) -> float:
    """Return the factor by which blocks that a tile shows already count as worse: 0 of exemplars that repeat."""
    return 0.0 if lattice.repeats else BLOCK_REPETITION_WEIGHT


def repetition_penalty(lattice: Lattice, places: Tensor, cells: tuple[int, int]) -> float:
    """Return the penalty on a quilt in which a piece comes back; 0 if the exemplar repeats itself.

    Args:
        lattice: the exemplar's lattice.
        places: the place (y, x) in the photograph of each cell of the quilt, in its sides, [2, rows, columns].
        cells: the rows and columns of cells that have the size of the whole photograph.
    """
    return 0.0 if lattice.repeats else REPEATED_SHARE_WEIGHT * repeated_share(places, cells)


def lost_order(lattice: Lattice, picture: Tensor, goal: float) -> float:
    """Return how far the share of an exemplar's order that a picture keeps lies below a goal; 0 without order.

    Args:
        lattice: the exemplar's lattice.
        picture: display values [3, H, W].
        goal: the share of order that a picture should keep, up to 1.
    """
    share = kept_order_share(lattice, picture)
    return 0.0 if math.isnan(share) else max(0.0, goal - share)


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


def resize_tile(layers: Tensor, colours: Tensor, size: tuple[int, int]) -> ResizedTile:
    """Make a tile of another size from pieces of a tile; structures keep their size and, where possible, their order.

    Args:
        layers: pictures or maps that tile and lie over each other, [C, H, W].
        colours: the tile by whose colours pieces agree, display values [3, rows, columns], one px for each cell.
        size: the height and width of the result in px.

    Returns:
        The tile, and its picture with one px for each cell.
    """
    own_size, cells = (layers.shape[1], layers.shape[2]), (colours.shape[1], colours.shape[2])
    tile_cells, lattice = count_tile_cells(size, own_size, cells), find_lattice(colours)
    holds_whole_tiles = all(length % own == 0 for length, own in zip(size, own_size, strict=True))
    stretched_first = (not holds_whole_tiles, holds_whole_tiles)
    sources = [make_piece_source(colours, tile_cells, stretches=stretches) for stretches in stretched_first]
    repetition_weight = find_repetition_weight(lattice)
    best, least = torch.empty(0), float("inf")
    for candidate in range(TILE_CANDIDATES):
        rng = np.random.default_rng(TILE_SEED + candidate)
        # blocks of as large a part of the tile as those of the tile are of a photograph
        block, overlap = (length * min(cells) // BLOCK_CELLS for length in BLOCKS[(1 + candidate) % len(BLOCKS)])
        blocks, source = (max(4, block), max(1, overlap)), sources[candidate % 2]
        places = quilt_places(source, tile_cells, blocks, rng, repetition_weight=repetition_weight)
        lost = lost_order(lattice, fetch_pieces(colours, places, tile_cells, cells), 1.0)
        if lost < least:
            best, least = places, lost
        if not lost:
            break
    return ResizedTile(fetch_pieces(layers, best, size, cells), fetch_pieces(colours, best, tile_cells, cells))


class ResizedTile(NamedTuple):
    """A tile made of pieces of a tile of another size.

    Attributes:
        layers: the layers of the tile, [C, H, W].
        colours: its picture with one px for each cell, [3, rows, columns].
    """

    layers: Tensor
    colours: Tensor

    def warn_of_lost_order(self, exemplar: Tensor, subject: str) -> None:
        """Warn if the tile keeps less than MIN_ORDER_SHARE_AGAIN of the regular structure of the photograph.

        Args:
            exemplar: the photograph with one px for each cell, display values [3, H, W].
            subject: the name of the task, with which the warning begins.
        """
        share = kept_order_share(find_lattice(remove_quadratic_trend(exemplar)), self.colours)
        if share < MIN_ORDER_SHARE_AGAIN:  # False for NaN: without a lattice nothing is lost
            warnings.warn(
                f"{subject}: cut for --size: keeps {share:.2f} of the photo's regular structure, expected "
                f"{MIN_ORDER_SHARE_AGAIN:g} or more; bricks or boards may be cut. The photo's own size keeps more.",
                stacklevel=2,
            )
