"""Warnings of fits that are black, or the same everywhere, where their inputs are not, and remarks on uniform inputs.

Functions return clauses, which callers print and record. The module compares values alone: callers say which quantity
of an input the values are.
"""

from __future__ import annotations

from torch import Tensor

UNIFORM_SPREAD = 1e-3  # (greatest - least) / greatest of a channel, up to which values count as the same everywhere
VARIED_SPREAD = 0.1  # spread from which values count as varied: below, one value may rightly fit noise of measurements
BLACK_SHARE = 1e-3  # share of the input's greatest value: a fit that is below it everywhere counts as black
COLLAPSE_REMEDY = "take another checkpoint or paradigm, or more steps"


def relative_spread(values: Tensor) -> float:
    """Return (greatest - least) / greatest of values >= 0 [C, ...], of the channel where it is greatest; 0 of black.

    >>> import torch
    >>> relative_spread(torch.tensor([[2.0, 2.0], [1.0, 4.0]]))
    0.75
    """
    channels = values.flatten(1)
    greatest = channels.amax(1)
    return float(((greatest - channels.amin(1)) / greatest.clamp_min(1e-30)).amax())


def uniform_input_remarks(values: Tensor, what: str) -> list[str]:
    """Return a clause on an input [C, ...] that is the same everywhere, which a file may hold rightly; else [].

    Args:
        values: values of the input, >= 0, not black.
        what: names the quantity, with its unit.
    """
    if not values.any() or relative_spread(values) > UNIFORM_SPREAD:
        return []
    colour = ", ".join(f"{value:.3g}" for value in values.flatten(1)[:, 0].tolist())
    return [f"the input is one {what} everywhere: {colour}"]


def black_fit_warnings(fit: Tensor, given: Tensor) -> list[str]:
    """Return a clause on a fit that is black where its input is not; else [].

    Args:
        fit: values of the fit, >= 0, [C, ...].
        given: values of the input, >= 0, [C, ...].
    """
    if fit.amax() >= BLACK_SHARE * given.amax():
        return []
    return [f"the fit is black, and its input is not: {COLLAPSE_REMEDY}"]


def collapsed_fit_warnings(fit: Tensor, given: Tensor) -> list[str]:
    """Return a clause on a fit that is black, or the same everywhere, where its input is not; else [].

    Args:
        fit: values of the fit, >= 0, [C, ...].
        given: values of the input, >= 0, [C, ...].
    """
    if relative_spread(fit) < UNIFORM_SPREAD and relative_spread(given) > VARIED_SPREAD:
        return black_fit_warnings(fit, given) or [
            f"the fit is the same everywhere, and its input is not: {COLLAPSE_REMEDY}"
        ]
    return black_fit_warnings(fit, given)
