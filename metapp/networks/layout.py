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

from metapp.appearance.order import lattice_of, levelled
from metapp.appearance.quilting import quilted
from metapp.learning.task import Params
from metapp.networks.layers import enlarged

CONTRAST = 1.5  # root mean square of layouts as networks get them
ASTRAY = 0.1  # weight in the loss of how far pictures are from their layouts
LEAST_SCORE = 0.3  # score of a lattice that layouts keep
MOST_STRETCH = 0.08  # most that a picture is stretched by
LEAST_VARIANCE = 1e-3  # variance of a layout, of display values, below which it counts for less


def quilted_layout(exemplar: Tensor, size: tuple[int, int]) -> Tensor:
    """A coarse picture [3, h, w] that tiles, quilted of an exemplar [3, H, W]; the same each time.

    It is as bright everywhere: a slow change of the exemplar would be a band where its ends meet.
    """
    return _quilted(shrunk(exemplar, size), size)


def shrunk(exemplar: Tensor, size: tuple[int, int]) -> Tensor:
    """The source of a layout of a size: an exemplar [3, H, W], levelled, stretched, at the layout's scale."""
    tiling = as_tile(levelled(exemplar), exemplar.shape[1:])
    part = [round(side * to / of) for side, to, of in zip(tiling.shape[1:], size, exemplar.shape[1:], strict=True)]
    return interpolate(tiling[None], size=part, mode="area")[0]


def requilted(layout: Tensor, size: tuple[int, int]) -> Tensor:
    """A layout [3, h, w] of another size, quilted of this one [3, H, W]; it tiles."""
    return _quilted(as_tile(layout, size), size)


def _quilted(exemplar: Tensor, size: tuple[int, int]) -> Tensor:
    """A picture that tiles, in blocks of half the side that share a third of theirs with their neighbours."""
    block = max(4, min(*exemplar.shape[1:], *size) // 2)
    numbers = np.random.default_rng(0)
    picture = quilted(exemplar.movedim(0, -1).cpu().numpy(), size, numbers, block=block, overlap=block // 3, tiles=True)
    return torch.from_numpy(picture).movedim(-1, 0).to(exemplar)


def as_tile(exemplar: Tensor, size: Sequence[int]) -> Tensor:
    """A picture [3, H, W] stretched by as little as lets its lattice, if a strong one, repeat with a tile's sides.

    Blocks of a regular pattern can agree across the edges of a tile of size (h, w), of the picture's scale, only where
    the tile holds whole periods. The result is smaller by the part that the stretched picture does not reach.
    """
    lattice = lattice_of(exemplar)
    if lattice.score < LEAST_SCORE:
        return exemplar
    texels = torch.tensor(size, dtype=lattice.vectors.dtype)
    vectors = lattice.vectors.clone()
    alone = not bool(vectors[1].any())
    if alone:  # one direction: what is across it stays
        vectors[1] = torch.stack([-vectors[0, 1], vectors[0, 0]])
    frequencies = torch.linalg.inv(vectors).T
    whole = torch.round(frequencies * texels) / texels
    if alone:
        whole[1] = frequencies[1]
    change = torch.linalg.solve(frequencies, whole)  # from places in the tile to places in the picture
    if float((change - torch.eye(2, dtype=change.dtype)).abs().max()) > MOST_STRETCH:
        return exemplar
    change = change.flip(0, 1).to(exemplar)  # (x, y)
    grid = affine_grid(torch.cat([change, change.new_zeros(2, 1)], 1)[None], [1, *exemplar.shape], align_corners=False)
    stretched = grid_sample(exemplar[None], grid, align_corners=False)[0]
    beyond = float(change.abs().sum(1).max()) - 1
    margin = 4 * math.ceil(max(beyond, 0.0) * max(exemplar.shape[1:]) / 8)  # whole texels of the layout stay whole
    height, width = exemplar.shape[1:]
    return stretched[:, margin : height - margin, margin : width - margin]


def layouts(layout: Tensor, noise: Tensor, times: float) -> Tensor:
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
        new = torch.stack([requilted(each, (height, width)) for each in layout])
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


def as_input(layout: Tensor, noise: Tensor) -> Tensor:
    """Layouts [T, B, 3, h, w] as a network reads them beside noise: of its size, without mean, of equal contrast."""
    centred = layout - layout.mean((-1, -2), keepdim=True)
    whole = CONTRAST * centred / centred.square().mean((-1, -2, -3), keepdim=True).sqrt().clamp_min(0.02)
    whole = whole.flatten(0, 1)
    while whole.shape[-1] < noise.shape[-1]:
        whole = enlarged(whole)
    result: Tensor = whole.unflatten(0, layout.shape[:2])
    return result


def astray(theta: Params, noise: Tensor, pictures: Tensor, times: float) -> Tensor:
    """Part of a loss [T]: how far pictures [T, B, 3, H, W], made of noise, are from their layouts.

    The squared difference of the coarse pictures over the layout's variance; 0 of networks that read no layout.
    """
    if "layout" not in theta:
        return pictures.new_zeros(len(pictures))
    layout = layouts(theta["layout"], noise, times)
    variance = layout.var((-1, -2)).mean(-1) + LEAST_VARIANCE
    return ((_pooled(pictures, times) - layout).square().mean((-1, -2, -3)) * (ASTRAY / variance)).mean(1)
