"""Absolute values that are rounded off near 0, as losses of differences."""

from __future__ import annotations

from torch import Tensor

from metapp.learning.rules import append_axes


def round_absolute(difference: Tensor, rounding: Tensor) -> Tensor:
    """Return |d| of differences d, rounded off below s: sqrt(d^2 + s^2) - s, whose gradient is smooth at 0.

    Args:
        difference: the differences d, [T, ...].
        rounding: s, [T], or [] for all tasks; above 0.

    >>> round_absolute(Tensor([[0.0, 3.0, -30.0]]), Tensor([4.0]))
    tensor([[ 0.0000,  1.0000, 26.2655]])
    """
    rounding = append_axes(rounding, difference)
    return (difference * difference + rounding * rounding).sqrt() - rounding
