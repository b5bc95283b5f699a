"""Layouts: coarse pictures, quilted of the exemplar, which a generator is given beside noise.

Statistics cannot bring order into noise: the layout says the places of courses, threads and boards.
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

LAYOUT_CONTRAST = 1.5  # root mean square of layouts as networks get them
LAYOUT_WEIGHT = 0.1  # weight in the loss of how far pictures are from their layouts
MIN_STRETCH_SCORE = 0.3  # score of a lattice for which a picture is stretched
MAX_STRETCH = 0.08  # most that a picture is stretched by
MIN_LAYOUT_VARIANCE = 1e-3  # variance of a layout, of display values, below which it counts for less
QUILT_CANDIDATES, ORDER_TOLERANCE = (
    8,
    0.1,
)  # quilts of a layout; difference from its source's order at which no more are made


def quilt_layout(exemplar: Tensor, size: tuple[int, int]) -> Tensor:
    """A coarse picture [3, h, w] that tiles, quilted of an exemplar [3, H, W]; the same each time.

    It is as bright everywhere: a slow change of the exemplar would be a band where its ends meet.
    """
    tile, frequencies = stretch_to_tile(remove_quadratic_trend(exemplar), exemplar.shape[1:])
    part = [round(side * to / of) for side, to, of in zip(tile.shape[1:], size, exemplar.shape[1:], strict=True)]
    small = interpolate(tile[None], size=part, mode="area")[0]
    scale = frequencies.new_tensor(exemplar.shape[1:]) / frequencies.new_tensor(size)
    return _quilted(small, size, scale * frequencies)


def requilt_layout(layout: Tensor, size: tuple[int, int]) -> Tensor:
    """A layout [3, h, w] of another size, quilted of this one [3, H, W]; it tiles."""
    tile, frequencies = stretch_to_tile(layout, size)
    return _quilted(tile, size, frequencies)


def _quilted(source: Tensor, size: tuple[int, int], frequencies: Tensor) -> Tensor:
    """A picture that tiles, in blocks of half the side that share a third of theirs with their neighbours.

    Of CANDIDATES the one whose order is nearest to that of its source [3, H, W]; every other one has blocks in phase.
    """
    block = max(4, min(*source.shape[1:], *size) // 2)
    lattice, pixels = find_lattice(source), source.movedim(0, -1).cpu().numpy()
    ordered = lattice.score > MIN_LATTICE_SCORE and float(lattice.vectors.abs().max()) < min(size) // 2
    best, least = source, math.inf
    for seed in range(QUILT_CANDIDATES if ordered else 1):
        in_phase = frequencies.numpy() if seed % 2 == 0 and len(frequencies) else None
        numbers = np.random.default_rng(seed)
        made = quilt(pixels, size, numbers, block=block, overlap=block // 3, tiles=True, frequencies=in_phase)
        picture = torch.from_numpy(made).movedim(-1, 0).to(source)
        off = abs(1 - kept_order_share(lattice, picture)) if ordered else 0.0
        best, least = (picture, off) if off < least else (best, least)
        if least < ORDER_TOLERANCE:
            break
    return best


def stretch_to_tile(exemplar: Tensor, size: Sequence[int]) -> tuple[Tensor, Tensor]:
    """A picture [3, H, W] stretched by as little as lets its lattice, if a strong one, repeat with a tile's sides.

    Blocks of a regular pattern can agree across the edges of a tile of size (h, w), of the picture's scale, only where
    the tile holds whole periods.

    Returns:
        The stretched picture, smaller by the part that it does not reach, or the picture as it is; the frequencies of
        its lattice, [0 to 2, 2] (y, x) in cycles per texel, none if it was not stretched.
    """
    lattice = find_lattice(exemplar)
    vectors = lattice.vectors.clone()
    as_it_is = exemplar, vectors[:0]
    if lattice.score < MIN_STRETCH_SCORE:
        return as_it_is
    texels = torch.tensor(size, dtype=vectors.dtype)
    alone = not bool(vectors[1].any())
    if alone:  # one direction: what is across it stays
        vectors[1] = torch.stack([-vectors[0, 1], vectors[0, 0]])
    frequencies = torch.linalg.inv(vectors).T
    whole = torch.round(frequencies * texels) / texels
    if alone:
        whole[1] = frequencies[1]
    change = torch.linalg.solve(frequencies, whole)  # from places in the tile to places in the picture
    if float((change - torch.eye(2, dtype=change.dtype)).abs().max()) > MAX_STRETCH:
        return as_it_is
    change = change.flip(0, 1).to(exemplar)  # (x, y)
    grid = affine_grid(torch.cat([change, change.new_zeros(2, 1)], 1)[None], [1, *exemplar.shape], align_corners=False)
    stretched = grid_sample(exemplar[None], grid, align_corners=False)[0]
    beyond = float(change.abs().sum(1).max()) - 1
    margin = 4 * math.ceil(max(beyond, 0.0) * max(exemplar.shape[1:]) / 8)  # whole texels of the layout stay whole
    height, width = exemplar.shape[1:]
    return stretched[:, margin : height - margin, margin : width - margin], whole[: 1 if alone else 2]


def move_layouts(layout: Tensor, noise: Tensor, times: float) -> Tensor:
    """The layouts of pictures made of noise: each moved by as much as the first numbers of its noise say.

    Args:
        layout: of each task, [T, 3, h, w].
        noise: [T, B, C, H, W].
        times: how many times as high and wide as their layouts pictures are, a power of 2; those of pictures of other
            sizes than `times` the layout's are quilted anew, and not moved.

    Returns:
        [T, B, 3, H / times, W / times], at most [T, B, 3, H, W].
    """
    layout = layout.detach()
    height, width = (round(side / times) for side in noise.shape[-2:])
    if (height, width) != layout.shape[-2:]:
        new = torch.stack([requilt_layout(each, (height, width)) for each in layout])
        return _pooled(new[:, None].expand(-1, noise.shape[1], -1, -1, -1), 1 / times)
    shares = torch.special.ndtr(noise[:, :, 0, 0, :2]).expand(len(layout), -1, -1).tolist()
    moved = [
        torch.stack([one.roll((int(y * height), int(x * width)), (1, 2)) for y, x in pairs])
        for one, pairs in zip(layout, shares, strict=True)
    ]
    return _pooled(torch.stack(moved), 1 / times)


def _pooled(pictures: Tensor, times: float) -> Tensor:
    """Pictures [T, B, C, H, W] at 1 / `times` their size; those that would be larger stay as they are."""
    if times <= 1:
        return pictures
    coarse: Tensor = avg_pool2d(pictures.flatten(0, 1), round(times)).unflatten(0, pictures.shape[:2])
    return coarse


def normalise_layouts(layout: Tensor, noise: Tensor) -> Tensor:
    """Layouts [T, B, 3, h, w] as a network reads them beside noise: of its size, without mean, of equal contrast."""
    centred = layout - layout.mean((-1, -2), keepdim=True)
    whole = LAYOUT_CONTRAST * centred / centred.square().mean((-1, -2, -3), keepdim=True).sqrt().clamp_min(0.02)
    whole = whole.flatten(0, 1)
    while whole.shape[-1] < noise.shape[-1]:
        whole = enlarge_periodic(whole)
    result: Tensor = whole.unflatten(0, layout.shape[:2])
    return result


def layout_deviation(theta: Params, noise: Tensor, pictures: Tensor, times: float) -> Tensor:
    """Part of a loss [T]: how far pictures [T, B, 3, H, W], made of noise, are from their layouts.

    The squared difference of the coarse pictures over the layout's variance; 0 of networks that read no layout.
    """
    if "layout" not in theta:
        return pictures.new_zeros(len(pictures))
    layout = move_layouts(theta["layout"], noise, times)
    variance = layout.var((-1, -2)).mean(-1) + MIN_LAYOUT_VARIANCE
    return ((_pooled(pictures, times) - layout).square().mean((-1, -2, -3)) * (LAYOUT_WEIGHT / variance)).mean(1)
