"""Numbers in memory, of numpy, torch or any other library, and vectors made of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

MAX_ARRAY_VALUES = 3 * 2**28  # numbers of an array, as of an image file


def array_of(name: str, source: object) -> NDArray[Any]:
    """Numbers of any kind, an array, a tensor on any device, nested lists, as a numpy array; halves become float32.

    Raises:
        ValueError: no numbers, masked ones, too many, or a tensor that is not dense.
    """
    if isinstance(source, np.ma.MaskedArray) and (masked := np.count_nonzero(np.ma.getmaskarray(source))):
        raise ValueError(f"{name}: {masked:,} values are masked, expected all; fill them: a.filled(0).")
    try:
        dense = source.detach().cpu().resolve_neg() if isinstance(source, Tensor) else source
        values = np.asarray(dense.float() if isinstance(dense, Tensor) and dense.dtype == torch.bfloat16 else dense)
    except Exception:  # whatever an object of another library raises
        values = np.asarray(None)
    if values.dtype.kind not in "uif":
        kind = f"an array of {values.dtype}" if values.ndim else type(source).__name__
        if isinstance(source, Tensor):
            kind = f"a tensor ({source.dtype}, {source.layout}, on {source.device})".replace("torch.", "")
        raise ValueError(f"{name}: {kind}, expected an array of numbers.")
    if values.size > MAX_ARRAY_VALUES:
        raise ValueError(
            f"{name}: {values.size:,} values, expected {MAX_ARRAY_VALUES:,} or fewer; take a part of them."
        )
    values = values.astype(values.dtype.newbyteorder("="), copy=False)
    return values.astype(np.float32) if values.dtype == np.float16 else values


def doubles_of(name: str, values: object) -> Tensor:
    """Return numbers of any kind as a float64 tensor, always a copy, since arrays may be read-only or run backwards.

    Args:
        name: begins errors.
        values: an array, a tensor or nested lists.

    Raises:
        ValueError: no numbers, masked ones or too many.
    """
    return torch.from_numpy(np.array(array_of(name, values), np.float64, order="C"))


def vectors_of(name: str, values: object, what: str) -> Tensor:
    """Return an array of vectors as a tensor [N, 3], float64.

    Args:
        name: begins errors.
        values: an array, a tensor or nested lists.
        what: names the vectors in errors.

    Raises:
        ValueError: no numbers; another shape.
    """
    array = doubles_of(f"{name}: {what}", values)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name}: {what} {tuple(array.shape)}, expected [N, 3].")
    return array


def unit_vectors(name: str, values: object, what: str) -> Tensor:
    """Return directions as unit vectors [N, 3], float64.

    Args:
        name: begins errors.
        values: an array, a tensor or nested lists.
        what: names the directions in errors.

    Raises:
        ValueError: no numbers; another shape; a length other than 1.
    """
    array = vectors_of(name, values, what)
    lengths = array.norm(dim=1, keepdim=True)
    if not ((lengths - 1).abs() < 1e-3).all():
        worst = float(lengths[(lengths - 1).abs().argmax()])
        raise ValueError(f"{name}: {what} of length {worst:.4g}, expected unit vectors.")
    unit: Tensor = array / lengths
    return unit
