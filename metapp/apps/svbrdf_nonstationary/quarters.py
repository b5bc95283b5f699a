"""Quarters of large pictures: what the outer loss is taken of, so that an outer step of training takes less time.

Each texel is in one quarter of four, and means in cells of a grid do not reach beyond one: the mean of the outer loss
over random quarters is that of the whole pictures, and so is its gradient. The encoder still reads the whole photo.
"""

from __future__ import annotations

import torch
from torch import Generator, Tensor

from metapp.appearance.flash import Maps
from metapp.apps.svbrdf_nonstationary.maps import decoded, inputs_of
from metapp.learning.task import Batch, Params
from metapp.networks.field import LocalField

LARGE = 128  # texels a side, above which quarters are taken


def drawn_quarters(field: LocalField, count: int, rng: Generator) -> Batch:
    """`quarter` [count] of each task, 0 to 3 as rows are read; nothing where the field is not large."""
    if field.height <= LARGE:
        return {}
    return {"quarter": torch.randint(4, (count,), generator=rng, device=rng.device)}


def quarter_of(pictures: Tensor, which: Tensor) -> Tensor:
    """A quarter [T, ..., H / 2, W / 2] of each of pictures [T, ..., H, W], H and W even; `which` is 0 to 3, [T]."""
    height, width = (size // 2 for size in pictures.shape[-2:])
    parts = pictures.unflatten(-1, (2, width)).unflatten(-3, (2, height)).movedim((-4, -2), (1, 2))
    chosen: Tensor = parts[torch.arange(len(which), device=which.device), which // 2, which % 2]
    return chosen


def in_quarters(field: LocalField, theta: Params, batch: Batch) -> tuple[Maps, Params, Batch]:
    """Maps [T, C, H / 2, W / 2] in the quarters that a batch names, and the same parameters and batch of these alone.

    `place` [T, 2, H / 2, W / 2] says where the texels are, as `metapp.appearance.flash.positions`. The field has a code
    for each texel.
    """
    which, inputs = batch["quarter"], inputs_of(batch["photo"])
    theta = theta | {key: quarter_of(theta[key], which) for key in ("z", "deviation") if key in theta}
    batch = batch | {key: quarter_of(batch[key], which) for key in ("photo", "others", "maps") if key in batch}
    inputs = quarter_of(inputs, which)
    height, width = inputs.shape[-2:]
    part = field._replace(height=height, width=width, rows=height, columns=width)
    return decoded(part(theta, inputs)), theta, batch | {"place": inputs[:, -2:]}
