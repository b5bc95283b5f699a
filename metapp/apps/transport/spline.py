"""Monotonic rational-quadratic splines on [0, 1] (Gregory & Delbourgo 1982; Durkan et al. 2019), many side by side.

A spline of K bins is described by 3 K + 1 numbers: logits of the bins' widths and of their masses, and terms added
to the log of the density at each knot. That log is, where 0 is added, the mean of those of both neighbours, so that one
number moves one bin and the density stays smooth about it. All zeros make the identity.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

MIN_BIN_SHARE = 1e-3  # of a bin's width, and of its mass
MAX_LOG_BEND = 5.0  # of what is added to the log of a density, either way
BELOW_ONE = 1 - 2**-24  # the largest of 32 bits


class Splines(NamedTuple):
    """Splines at work; N is 1 if all places share one.

    Attributes:
        widths: of the bins, [..., K, N], which sum to 1.
        masses: of the bins, likewise.
        bends: terms of the log of the density at the knots, [..., K + 1, N].
    """

    widths: Tensor
    masses: Tensor
    bends: Tensor


class Bin(NamedTuple):
    """The bin that a place is in, each entry [..., N].

    Attributes:
        which: its number, [..., 1, N].
        width, log_density: of it, the latter the mean.
        first, last: the density at its ends over its mean.
    """

    which: Tensor
    width: Tensor
    log_density: Tensor
    first: Tensor
    last: Tensor


def count_numbers(bins: int) -> int:
    """The count of numbers that describe a spline."""
    return 3 * bins + 1


def decode_splines(numbers: Tensor) -> Splines:
    """Splines of any numbers [..., 3 K + 1, N]."""
    count = numbers.shape[-2] // 3
    widths, masses, bends = numbers.split([count, count, count + 1], -2)
    share = 1 - count * MIN_BIN_SHARE
    return Splines(widths.softmax(-2) * share + MIN_BIN_SHARE, masses.softmax(-2) * share + MIN_BIN_SHARE, bends)


def _at(values: Tensor, index: Tensor) -> Tensor:
    """The entries [..., N] of [..., K, N or 1] at an index [..., 1, N]."""
    return values.expand(*values.shape[:-1], index.shape[-1]).gather(-2, index).squeeze(-2)


def _bin(splines: Splines, index: Tensor) -> Bin:
    """The bin of an index, of its neighbours."""
    at = torch.cat([(index - 1).clamp_min(0), index, (index + 1).clamp_max(splines.widths.shape[-2] - 1)], -2)
    widths, masses = (each.expand(*each.shape[:-1], at.shape[-1]).gather(-2, at) for each in splines[:2])
    logs = masses.log() - widths.log()
    knots = torch.cat([index, index + 1], -2)
    bends = splines.bends.expand(*splines.bends.shape[:-1], at.shape[-1]).gather(-2, knots)
    middle = logs[..., 1:2, :]
    ends = (0.5 * (logs[..., ::2, :] - middle) + MAX_LOG_BEND * torch.tanh(bends / MAX_LOG_BEND)).exp()
    return Bin(index, widths[..., 1, :], middle.squeeze(-2), ends[..., 0, :], ends[..., 1, :])


def _log_slope(cell: Bin, t: Tensor) -> Tensor:
    """The log of the density over the bin's mean, at a share t of its width."""
    both, rest = t * (1 - t), 1 - t
    top = cell.last * t * t + 2 * both + cell.first * rest * rest
    return top.log() - 2 * torch.log1p((cell.first + cell.last - 2) * both)


def _find(splines: Splines, places: Tensor) -> tuple[Bin, Tensor]:
    """The bins that places [..., N] are in, and how far into them, in [0, 1]."""
    ends = splines.widths.cumsum(-2)
    index = (places.unsqueeze(-2) >= ends.detach()[..., :-1, :]).sum(-2, keepdim=True)
    cell = _bin(splines, index)
    return cell, (1 - (_at(ends, index) - places) / cell.width).clamp(0, 1)


def log_density(numbers: Tensor, places: Tensor) -> Tensor:
    """The log of the splines' slopes, which is that of the density of their arguments.

    Args:
        numbers: of the splines, [..., 3 K + 1, N].
        places: in [0, 1], [..., N].

    Returns:
        [..., N].
    """
    cell, t = _find(decode_splines(numbers), places)
    return cell.log_density + _log_slope(cell, t)


def cell_masses(numbers: Tensor, cells: int) -> Tensor:
    """The masses of so many cells of the same width, [..., cells, N]."""
    splines, like = decode_splines(numbers), numbers[..., 0, :]
    within = [cumulative_mass(splines, torch.full_like(like, i / cells)) for i in range(1, cells)]
    ends = torch.stack([torch.zeros_like(like), *within, torch.ones_like(like)], -2)
    return ends.diff(dim=-2).clamp_min(0)


def cumulative_mass(splines: Splines, places: Tensor) -> Tensor:
    """The splines themselves: the mass left of places in [0, 1], of the shapes of `log_density`."""
    cell, t = _find(splines, places)
    both, mass = t * (1 - t), _at(splines.masses, cell.which)
    share = (t * t + cell.first * both) / (1 + (cell.first + cell.last - 2) * both)
    return _at(splines.masses.cumsum(-2), cell.which) - mass * (1 - share)
