"""Inputs that are the same everywhere, and fits that are so, or black, where their inputs are not."""

from __future__ import annotations

from torch import Tensor

UNIFORM_SPREAD = 1e-3  # (greatest - least) / greatest of a channel, up to which values are the same everywhere
VARIED_SPREAD = 0.1  # from which they are not: noise of measurements of one diffuse reflectance may be fitted by it
BLACK_SHARE = 1e-3  # of the input's greatest value: a fit that is below it everywhere is black
COLLAPSE_REMEDY = "take another checkpoint or paradigm, or more steps"


def relative_spread(values: Tensor) -> float:
    """Return (greatest - least) / greatest of values >= 0 [C, ...], of the channel where it is greatest; 0 of black.

    >>> import torch
    >>> spread_of(torch.tensor([[2.0, 2.0], [1.0, 4.0]]))
    0.75
    """
    channels = values.flatten(1)
    high = channels.amax(1)
    return float(((high - channels.amin(1)) / high.clamp_min(1e-30)).amax())


def uniform_input_remarks(values: Tensor, what: str) -> list[str]:
    """Return a clause on an input [C, ...] that is the same everywhere, which a file may hold rightly; else [].

    Args:
        values: of the input, >= 0, not black.
        what: it is, with its unit.
    """
    if not values.any() or relative_spread(values) > UNIFORM_SPREAD:
        return []
    colour = ", ".join(f"{value:.3g}" for value in values.flatten(1)[:, 0].tolist())
    return [f"the input is one {what} everywhere: {colour}"]


def black_fit_warnings(fit: Tensor, given: Tensor) -> list[str]:
    """Return a clause on a fit that is black where its input is not; else []. Arguments as of `collapsed_fit_warnings`."""
    if fit.amax() >= BLACK_SHARE * given.amax():
        return []
    return [f"the fit is black, and its input is not: {COLLAPSE_REMEDY}"]


def collapsed_fit_warnings(fit: Tensor, given: Tensor) -> list[str]:
    """Return a clause on a fit that is black, or the same everywhere, where what it was fitted to is not; else [].

    Args:
        fit: values of the fit, >= 0, [C, ...].
        given: values of the input, >= 0, [C, ...].
    """
    if relative_spread(fit) < UNIFORM_SPREAD and relative_spread(given) > VARIED_SPREAD:
        return black_fit_warnings(fit, given) or [
            f"the fit is the same everywhere, and its input is not: {COLLAPSE_REMEDY}"
        ]
    return black_fit_warnings(fit, given)
