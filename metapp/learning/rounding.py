"""Absolute values that are rounded off near 0, as losses of differences."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from metapp.learning.rules import append_axes
from metapp.learning.task import Params


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


def initial_smoothing(steps: int, smoothing: float) -> Params:
    """Return initial values of the loss parameter `smoothing` [steps], logs of s in :func:`smooth_absolute`."""
    return {"smoothing": torch.full((steps,), math.log(smoothing))}


def smooth_absolute(difference: Tensor, loss_parameters: Params) -> Tensor:
    """Return |d| of differences d [T, ...], or sqrt(d^2 + s^2) - s where a rule has learned the loss parameter s.

    Args:
        difference: the differences.
        loss_parameters: `smoothing` [T], the logs of s; {} for |d|.
    """
    if not loss_parameters:
        return difference.abs()
    return round_absolute(difference, torch.exp(loss_parameters["smoothing"]))
