"""Layouts: coarse pictures, quilted of the exemplar, which a generator reads beside noise.

Statistics of features cannot bring order into noise: the layout says where courses, threads and boards lie.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import affine_grid, avg_pool2d, grid_sample, interpolate

from metapp.appearance.order import MIN_LATTICE_SCORE, find_lattice, kept_order_share, remove_quadratic_trend
from metapp.appearance.quilting import quilt
from metapp.learning.task import Params
from metapp.networks.layers import enlarge_periodic

LAYOUT_CONTRAST = 1.5  # root mean square of layouts as networks read them, about a mean of 0
LAYOUT_WEIGHT = 0.1  # weight in a loss of the difference of pictures from their layouts
MIN_STRETCH_SCORE = 0.3  # score of a lattice, 0 to 1, from which on a picture is stretched
MAX_STRETCH = 0.08  # relative change of lengths: a picture is stretched by at most so much
MIN_LAYOUT_VARIANCE = 1e-3  # of display values, added to a layout's variance, so that flat ones count for less
QUILT_CANDIDATES = 8  # quilts of one ordered picture, of which the best one is taken
ORDER_TOLERANCE = 0.1  # relative difference from the order of its source at which a quilt is good enough


def quilt_layout(exemplar: Tensor, size: tuple[int, int]) -> Tensor:
    """Quilt the layout of an exemplar: a coarse picture that tiles.

    A slow change of brightness is removed first: it would be an edge where the ends of a tile meet. Nothing is drawn
    at random.

    Args:
        exemplar: display values [3, H, W].
        size: height and width of the layout in texels.

    Returns:
        The layout, [3, height, width].
    """
    tile, frequencies = stretch_to_tile(remove_quadratic_trend(exemplar), exemplar.shape[1:])
    small_size = [
        round(tile_side * layout_side / exemplar_side)
        for tile_side, layout_side, exemplar_side in zip(tile.shape[1:], size, exemplar.shape[1:], strict=True)
    ]
    small_tile = interpolate(tile[None], size=small_size, mode="area")[0]
    scale = frequencies.new_tensor(exemplar.shape[1:]) / frequencies.new_tensor(size)
    return _quilt_best(small_tile, size, scale * frequencies)


def requilt_layout(layout: Tensor, size: tuple[int, int]) -> Tensor:
    """Quilt a layout [3, h, w] of another size, which tiles, too, of the layout [3, H, W] of an exemplar."""
    tile, frequencies = stretch_to_tile(layout, size)
    return _quilt_best(tile, size, frequencies)


def _quilt_best(source: Tensor, size: tuple[int, int], frequencies: Tensor) -> Tensor:
    """Quilt a picture that tiles, [3, h, w]: of QUILT_CANDIDATES the one whose order is nearest to its source's.

    Blocks have half the shorter side and share a third of their side with their neighbours. Of a source without order
    there is one candidate.

    Args:
        source: the picture [3, H, W] of which blocks are taken.
        size: height and width of the quilt in texels.
        frequencies: the frequencies of the source's lattice, [0 to 2, 2] in cycles per texel; blocks of every other
            candidate are in phase with it.
    """
    block = max(4, min(*source.shape[1:], *size) // 2)
    lattice, pixels = find_lattice(source), source.movedim(0, -1).cpu().numpy()
    is_ordered = lattice.score > MIN_LATTICE_SCORE and float(lattice.vectors.abs().max()) < min(size) // 2
    best_picture, least_difference = source, math.inf
    for seed in range(QUILT_CANDIDATES if is_ordered else 1):
        in_phase = frequencies.numpy() if seed % 2 == 0 and len(frequencies) else None
        rng = np.random.default_rng(seed)
        quilt_pixels = quilt(pixels, size, rng, block=block, overlap=block // 3, tiles=True, frequencies=in_phase)
        picture = torch.from_numpy(quilt_pixels).movedim(-1, 0).to(source)
        order_difference = abs(1 - kept_order_share(lattice, picture)) if is_ordered else 0.0
        if order_difference < least_difference:
            best_picture, least_difference = picture, order_difference
        if least_difference < ORDER_TOLERANCE:
            break
    return best_picture


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
    if lattice.score < MIN_STRETCH_SCORE:
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
    # a multiple of 4, so that the layout's texels stay whole
    margin = 4 * math.ceil(max(excess, 0.0) * max(exemplar.shape[1:]) / 8)
    height, width = exemplar.shape[1:]
    result: Tensor = stretched[:, margin : height - margin, margin : width - margin]
    return result


def move_layouts(layout: Tensor, noise: Tensor, times: float) -> Tensor:
    """Return the layout of each picture that is made of noise: moved periodically as the picture's first numbers say.

    Args:
        layout: the layout of each task, [T, 3, h, w].
        noise: the noise of B pictures of each task, [T, B, C, H, W].
        times: the ratio of the sides of pictures and their layouts, a power of 2. If pictures have another size than
            `times` the layout's, layouts are quilted anew, and not moved.

    Returns:
        Layouts [T, B, 3, H / times, W / times], but never finer than pictures, [T, B, 3, H, W].
    """
    layout = layout.detach()
    height, width = (round(side / times) for side in noise.shape[-2:])
    if (height, width) != layout.shape[-2:]:
        requilted = torch.stack([requilt_layout(task_layout, (height, width)) for task_layout in layout])
        return _pool(requilted[:, None].expand(-1, noise.shape[1], -1, -1, -1), 1 / times)
    shares = torch.special.ndtr(noise[:, :, 0, 0, :2]).expand(len(layout), -1, -1).tolist()
    moved_layouts = [
        torch.stack([task_layout.roll((int(y * height), int(x * width)), (1, 2)) for y, x in task_shares])
        for task_layout, task_shares in zip(layout, shares, strict=True)
    ]
    return _pool(torch.stack(moved_layouts), 1 / times)


def _pool(pictures: Tensor, times: float) -> Tensor:
    """Average pictures [T, B, C, H, W] to 1 / `times` of their sides; they stay as they are where it is at most 1."""
    if times <= 1:
        return pictures
    coarse: Tensor = avg_pool2d(pictures.flatten(0, 1), round(times)).unflatten(0, pictures.shape[:2])
    return coarse


def normalise_layouts(layout: Tensor, noise: Tensor) -> Tensor:
    """Enlarge layouts [T, B, 3, h, w] to the size of noise [T, B, C, H, W], with mean 0 and equal contrast."""
    centred = layout - layout.mean((-1, -2), keepdim=True)
    normalised = LAYOUT_CONTRAST * centred / centred.square().mean((-1, -2, -3), keepdim=True).sqrt().clamp_min(0.02)
    normalised = normalised.flatten(0, 1)
    while normalised.shape[-1] < noise.shape[-1]:
        normalised = enlarge_periodic(normalised)
    result: Tensor = normalised.unflatten(0, layout.shape[:2])
    return result


def layout_deviation(theta: Params, noise: Tensor, pictures: Tensor, times: float) -> Tensor:
    """Return the part of a loss, [T], that keeps pictures near their layouts.

    It is LAYOUT_WEIGHT times the squared difference of coarse pictures and layouts over the layout's variance, and 0
    for networks that read no layout.

    Args:
        theta: fits, with the `layout` [T, 3, h, w] of each if networks read one.
        noise: the noise of B pictures of each task, [T, B, C, H, W].
        pictures: display values [T, B, 3, H, W] that were made of the noise.
        times: the ratio of the sides of pictures and layouts; see :func:`move_layouts`.
    """
    if "layout" not in theta:
        return pictures.new_zeros(len(pictures))
    layout = move_layouts(theta["layout"], noise, times)
    variance = layout.var((-1, -2)).mean(-1) + MIN_LAYOUT_VARIANCE
    return ((_pool(pictures, times) - layout).square().mean((-1, -2, -3)) * (LAYOUT_WEIGHT / variance)).mean(1)
