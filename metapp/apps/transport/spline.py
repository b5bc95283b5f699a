"""Monotonic rational-quadratic splines on [0, 1] (Gregory & Delbourgo 1982; Durkan et al. 2019), many side by side.

A spline of K bins is described by 3 K + 1 numbers: logits of the bins' widths and of their masses, and terms that are
added to the log of the density at each knot. Where 0 is added, that log is the mean of both neighbouring bins' log
densities, so that one number moves one bin and the density stays smooth about it. All zeros make the identity.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

MIN_BIN_SHARE = 1e-3  # the least width of a bin, and its least mass
MAX_LOG_BEND = 5.0  # the greatest absolute value of what is added to the log of a density
BELOW_ONE = 1 - 2**-24  # the largest float32 below 1


class Splines(NamedTuple):
    """Splines whose numbers are decoded; N is 1 if all places share one spline.

    Attributes:
        widths: widths of the bins, [..., K, N], which sum to 1.
        masses: masses of the bins, [..., K, N], which sum to 1.
        bends: terms of the log density at the knots, [..., K + 1, N].
    """

    widths: Tensor
    masses: Tensor
    bends: Tensor


class Bin(NamedTuple):
    """The bin of a spline that a place is in; each entry is [..., N] unless it says another shape.

    Attributes:
        bin_index: number of the bin, [..., 1, N].
        width: width of the bin.
        log_density: log of the bin's mean density.
        first, last: densities at the bin's ends over its mean density.
    """

    bin_index: Tensor
    width: Tensor
    log_density: Tensor
    first: Tensor
    last: Tensor


def count_numbers(bins: int) -> int:
    """Return the count of numbers that describe a spline."""
    return 3 * bins + 1


def decode_splines(numbers: Tensor) -> Splines:
    """Decode unbounded numbers [..., 3 K + 1, N] to splines."""
    count = numbers.shape[-2] // 3
    widths, masses, bends = numbers.split([count, count, count + 1], -2)
    share = 1 - count * MIN_BIN_SHARE
    return Splines(widths.softmax(-2) * share + MIN_BIN_SHARE, masses.softmax(-2) * share + MIN_BIN_SHARE, bends)


def _gather_bins(values: Tensor, index: Tensor) -> Tensor:
    """Return the entries [..., N] of values [..., K, N or 1] at an index [..., 1, N]."""
    return values.expand(*values.shape[:-1], index.shape[-1]).gather(-2, index).squeeze(-2)


def _make_bin(splines: Splines, index: Tensor) -> Bin:
    """Return the bin of an index [..., 1, N], whose densities at its ends depend on its neighbours."""
    neighbours = torch.cat([(index - 1).clamp_min(0), index, (index + 1).clamp_max(splines.widths.shape[-2] - 1)], -2)
    widths, masses = (
        values.expand(*values.shape[:-1], neighbours.shape[-1]).gather(-2, neighbours) for values in splines[:2]
    )
    logs = masses.log() - widths.log()
    knots = torch.cat([index, index + 1], -2)
    bends = splines.bends.expand(*splines.bends.shape[:-1], neighbours.shape[-1]).gather(-2, knots)
    middle = logs[..., 1:2, :]
    ends = (0.5 * (logs[..., ::2, :] - middle) + MAX_LOG_BEND * torch.tanh(bends / MAX_LOG_BEND)).exp()
    return Bin(index, widths[..., 1, :], middle.squeeze(-2), ends[..., 0, :], ends[..., 1, :])


def _log_slope(cell: Bin, t: Tensor) -> Tensor:
    """Return the log of the density over the bin's mean, at a share t of its width, [..., N]."""
    product, rest = t * (1 - t), 1 - t
    numerator = cell.last * t * t + 2 * product + cell.first * rest * rest
    return numerator.log() - 2 * torch.log1p((cell.first + cell.last - 2) * product)


def _find_bins(splines: Splines, places: Tensor) -> tuple[Bin, Tensor]:
    """Return the bins that places [..., N] are in, and how far into them the places are, in [0, 1], [..., N]."""
    ends = splines.widths.cumsum(-2)
    index = (places.unsqueeze(-2) >= ends.detach()[..., :-1, :]).sum(-2, keepdim=True)
    cell = _make_bin(splines, index)
    return cell, (1 - (_gather_bins(ends, index) - places) / cell.width).clamp(0, 1)


def log_density(numbers: Tensor, places: Tensor) -> Tensor:
    """Return the log density of places, [..., N]: the log of the splines' slopes there.

    Args:
        numbers: numbers of the splines, [..., 3 K + 1, N].
        places: places in [0, 1], [..., N].
    """
    cell, t = _find_bins(decode_splines(numbers), places)
    return cell.log_density + _log_slope(cell, t)


def cell_masses(numbers: Tensor, cells: int) -> Tensor:
    """Return the masses of `cells` cells of equal width, [..., cells, N].

    Args:
        numbers: numbers of the splines, [..., 3 K + 1, N].
        cells: number of cells.
    """
    splines, like = decode_splines(numbers), numbers[..., 0, :]
    inner_ends = [cumulative_mass(splines, torch.full_like(like, i / cells)) for i in range(1, cells)]
    ends = torch.stack([torch.zeros_like(like), *inner_ends, torch.ones_like(like)], -2)
    return ends.diff(dim=-2).clamp_min(0)


def cumulative_mass(splines: Splines, places: Tensor) -> Tensor:
    """Return the values of splines, the mass left of places, [..., N].

    Args:
        splines: the splines.
        places: places in [0, 1], [..., N].
    """
    cell, t = _find_bins(splines, places)
    product, mass = t * (1 - t), _gather_bins(splines.masses, cell.bin_index)
    mass_share = (t * t + cell.first * product) / (1 + (cell.first + cell.last - 2) * product)
    return _gather_bins(splines.masses.cumsum(-2), cell.bin_index) - mass * (1 - mass_share)
