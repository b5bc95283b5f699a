"""Layouts: coarse pictures of what a generator makes, quilted of the exemplar, which it is given beside noise.

Statistics cannot bring order into noise: where courses, threads and boards lie, the layout says.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

from metapp.appearance.quilting import quilted
from metapp.learning.task import Params
from metapp.networks.layers import enlarged

CONTRAST = 1.5  # root mean square of layouts as networks get them
ASTRAY = 0.1  # weight in the loss of how far pictures are from their layouts
FAINT = 1e-3  # variance of a layout, of display values, below which it counts for less


def quilted_layout(exemplar: Tensor, size: tuple[int, int]) -> Tensor:
    """A coarse picture [3, h, w] that tiles, quilted of an exemplar [3, H, W]; the same each time."""
    coarse = interpolate(exemplar[None], size=size, mode="area")[0] if exemplar.shape[-2:] != size else exemplar
    return requilted(coarse, size)


def requilted(layout: Tensor, size: tuple[int, int]) -> Tensor:
    """A layout [3, h, w] of another size, quilted of this one [3, H, W]."""
    block = max(4, min(*layout.shape[1:], *size) // 4)
    picture = quilted(
        layout.movedim(0, -1).cpu().numpy(), size, np.random.default_rng(0), block=block, overlap=block // 3, tiles=True
    )
    return torch.from_numpy(picture).movedim(-1, 0).to(layout)


def layouts(layout: Tensor, noise: Tensor, times: int) -> Tensor:
    """The layouts of pictures made of noise: each moved by as much as the first numbers of its noise say.

    Args:
        layout: of each task, [T, 3, h, w].
        noise: [T, B, C, H, W].
        times: how many times as high and wide as their layouts pictures are; those of pictures of other sizes than
            `times` the layout's are quilted anew, and not moved.

    Returns:
        [T, B, 3, H / times, W / times].
    """
    layout = layout.detach()
    height, width = (side // times for side in noise.shape[-2:])
    if (height, width) != layout.shape[-2:]:
        new = torch.stack([requilted(each, (height, width)) for each in layout])
        return new[:, None].expand(-1, noise.shape[1], -1, -1, -1)
    shares = torch.special.ndtr(noise[:, :, 0, 0, :2]).expand(len(layout), -1, -1).tolist()
    moved = [
        torch.stack([one.roll((int(y * height), int(x * width)), (1, 2)) for y, x in pairs])
        for one, pairs in zip(layout, shares, strict=True)
    ]
    return torch.stack(moved)


def as_input(layout: Tensor, noise: Tensor) -> Tensor:
    """Layouts [T, B, 3, h, w] as a network reads them beside noise: of its size, without mean, of equal contrast."""
    centred = layout - layout.mean((-1, -2), keepdim=True)
    whole = CONTRAST * centred / centred.square().mean((-1, -2, -3), keepdim=True).sqrt().clamp_min(0.02)
    whole = whole.flatten(0, 1)
    while whole.shape[-1] < noise.shape[-1]:
        whole = enlarged(whole)
    result: Tensor = whole.unflatten(0, layout.shape[:2])
    return result


def astray(theta: Params, noise: Tensor, pictures: Tensor, times: int) -> Tensor:
    """Part of a loss [T]: how far pictures [T, B, 3, H, W], made of noise, are from their layouts.

    The squared difference of the coarse pictures over the layout's variance; 0 of networks that read no layout.
    """
    if "layout" not in theta:
        return pictures.new_zeros(len(pictures))
    layout = layouts(theta["layout"], noise, times)
    coarse: Tensor = avg_pool2d(pictures.flatten(0, 1), times).unflatten(0, pictures.shape[:2])
    variance = layout.var((-1, -2)).mean(-1) + FAINT
    return ((coarse - layout).square().mean((-1, -2, -3)) * (ASTRAY / variance)).mean(1)
