"""The least stretch of a picture by which its lattice repeats with the sides of a tile.

Pieces of a regular pattern can agree across the edges of a tile only where the tile holds whole periods of the pattern.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.functional import affine_grid, grid_sample

from metapp.appearance.lattice import find_lattice

MAX_STRETCH = 0.08  # relative change of lengths: a picture is stretched by at most so much


def stretch_to_tile(exemplar: Tensor, size: Sequence[int]) -> tuple[Tensor, Tensor]:
    """Stretch a picture as little as lets its lattice repeat with the sides of a tile.

    Blocks of a regular pattern can agree across the edges of a tile only where the tile holds whole periods. A picture
    without a strong lattice, or one that would have to be stretched by more than MAX_STRETCH, stays as it is.

    Args:
        exemplar: the picture, [3, H, W].
        size: height and width of the tile, in texels of the picture.

    Returns:
        The stretched picture without the margin that stretching leaves empty, or the picture as it is; the frequencies
        of its lattice, [0 to 2, 2] (y, x) in cycles per texel, none if it was not stretched.
    """
    change, frequencies = find_stretch(exemplar, size)
    return (exemplar if change is None else apply_stretch(exemplar, change)), frequencies


def find_stretch(exemplar: Tensor, size: Sequence[int]) -> tuple[Tensor | None, Tensor]:
    """Find the least stretch of a picture that lets its lattice repeat with the sides of a tile.

    Args:
        exemplar: the picture, [3, H, W].
        size: height and width of the tile, in texels of the picture.

    Returns:
        The matrix [2, 2] from (x, y) in the stretched picture to (x, y) in the picture, about their centres, and the
        frequencies of the stretched picture's lattice; see :func:`stretch_to_tile`. None and no frequencies if the
        picture stays as it is.
    """
    lattice = find_lattice(exemplar)
    vectors = lattice.vectors.clone()
    unstretched = None, vectors[:0]
    if not lattice.repeats:
        return unstretched
    texels = torch.tensor(size, dtype=vectors.dtype)
    one_direction = not bool(vectors[1].any())
    if one_direction:  # the lattice has one direction: lengths across it stay
        vectors[1] = torch.stack([-vectors[0, 1], vectors[0, 0]])
    frequencies = torch.linalg.inv(vectors).T
    whole_frequencies = torch.round(frequencies * texels) / texels
    if one_direction:
        whole_frequencies[1] = frequencies[1]
    # maps positions in the tile to positions in the picture
    change = torch.linalg.solve(frequencies, whole_frequencies)
    if float((change - torch.eye(2, dtype=change.dtype)).abs().max()) > MAX_STRETCH:
        return unstretched
    directions = 1 if one_direction else 2
    return change.flip(0, 1).to(exemplar), whole_frequencies[:directions]  # affine_grid wants (x, y)


def apply_stretch(exemplar: Tensor, change: Tensor) -> Tensor:
    """Stretch a picture [C, H, W] by a matrix of :func:`find_stretch`, without the margin that this leaves empty."""
    grid = affine_grid(torch.cat([change, change.new_zeros(2, 1)], 1)[None], [1, *exemplar.shape], align_corners=False)
    stretched = grid_sample(exemplar[None], grid, align_corners=False)[0]
    excess = float(change.abs().sum(1).max()) - 1
    # a multiple of 4, so that a picture of a quarter of the size has whole texels, too
    margin = 4 * math.ceil(max(excess, 0.0) * max(exemplar.shape[1:]) / 8)
    height, width = exemplar.shape[1:]
    result: Tensor = stretched[:, margin : height - margin, margin : width - margin]
    return result
