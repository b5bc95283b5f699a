"""Numbers in memory, of numpy, torch or any other library, and vectors made of them.

All readers of objects in memory check them here, so that a user's array is refused by one line for one fault.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Doubles = NDArray[np.float64]

MAX_ARRAY_VALUES = 3 * 2**28  # as many as the largest image file may hold


def array_of(name: str, source: object) -> NDArray[Any]:
    """Return numbers of any kind as a numpy array; halves become float32.

    Args:
        name: the name of the numbers in errors.
        source: an array, a tensor on any device, or nested lists.

    Raises:
        ValueError: the source is no numbers, has masked or too many ones, or is a tensor that is not dense.
    """
    if isinstance(source, np.ma.MaskedArray) and (masked := np.count_nonzero(np.ma.getmaskarray(source))):
        raise ValueError(f"{name}: {masked:,} values are masked, expected none; replace them, such as by a.filled(0).")
    try:
        dense = source.detach().cpu().resolve_neg() if isinstance(source, Tensor) else source
        values = np.asarray(dense.float() if isinstance(dense, Tensor) and dense.dtype == torch.bfloat16 else dense)
    except Exception:  # an object of another library may raise anything
        values = np.asarray(None)
    if values.dtype.kind not in "uif":
        kind = f"an array of {values.dtype}" if values.ndim else type(source).__name__
        if isinstance(source, Tensor):
            kind = f"a tensor ({source.dtype}, {source.layout}, on {source.device})".replace("torch.", "")
        raise ValueError(f"{name}: {kind}, expected an array of numbers; convert it to one.")
    if values.size > MAX_ARRAY_VALUES:
        raise ValueError(
            f"{name}: {values.size:,} values, expected {MAX_ARRAY_VALUES:,} or fewer; take a part of them."
        )
    values = values.astype(values.dtype.newbyteorder("="), copy=False)
    return values.astype(np.float32) if values.dtype == np.float16 else values


def doubles_of(name: str, values: object) -> Tensor:
    """Return numbers of any kind as a float64 tensor, always a copy, since arrays may be read-only or run backwards.

    Args:
        name: the name of the numbers in errors.
        values: an array, a tensor or nested lists.

    Raises:
        ValueError: the values are no numbers, masked or too many.
    """
    return torch.from_numpy(np.array(array_of(name, values), np.float64, order="C"))


def vectors_of(name: str, values: object, what: str) -> Tensor:
    """Return an array of vectors as a tensor [N, 3], float64.

    Args:
        name: the name of the source in errors.
        values: an array, a tensor or nested lists.
        what: the name of the vectors in errors.

    Raises:
        ValueError: the values are no numbers, or have another shape.
    """
    array = doubles_of(f"{name}: {what}", values)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name}: {what} {tuple(array.shape)}, expected [N, 3], a vector in each row; reshape it.")
    return array


def unit_vectors(name: str, values: object, what: str) -> Tensor:
    """Return directions as unit vectors [N, 3], float64.

    Args:
        name: the name of the source in errors.
        values: an array, a tensor or nested lists.
        what: the name of the directions in errors.

    Raises:
        ValueError: the values are no numbers, or have another shape, or a length other than 1.
    """
    array = vectors_of(name, values, what)
    lengths = array.norm(dim=1, keepdim=True)
    if not ((lengths - 1).abs() < 1e-3).all():
        worst = float(lengths[(lengths - 1).abs().argmax()])
        raise ValueError(f"{name}: {what} of length {worst:.4g}, expected unit vectors; divide them by their lengths.")
    unit: Tensor = array / lengths
    return unit
