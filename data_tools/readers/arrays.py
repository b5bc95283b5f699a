"""Arrays, tensors and PIL pictures in memory, read as the pictures that readers of files return.

Pictures are PIL pictures, or arrays or tensors [H, W, 3] or gray [H, W], rows from the top. Integers of 8 or 16 bits
are sRGB, floating-point values are display values in [0, 1].
"""

from __future__ import annotations

from typing import TypeGuard

import numpy as np
from PIL.Image import Image
from torch import Tensor

from data_tools.readers.colours import SRGB_SPACE, Array
from data_tools.readers.image_files import Pixels, check_size, pixels_of_pil
from data_tools.readers.numbers import array_of

_EXPECTED = "a path, a picture (of PIL, or an array or tensor [H, W, 3])"
_SLACK = 1e-3  # distance by which rounding may leave a range


def pixels_of(name: str, source: object, others: str = "") -> Pixels:
    """Read a picture in memory as a reader of files reads a file.

    Args:
        name: the name of the picture in errors.
        source: a PIL picture, an array or a tensor.
        others: further inputs that the caller takes, in words, for errors.

    Raises:
        ValueError: the source is no picture, or has another shape, type, size or range.
    """
    if not is_picture(source):
        raise ValueError(f"{name}: {type(source).__name__}, expected {_EXPECTED}{others}.")
    if is_pil(source):
        return check_pixels(name, pixels_of_pil(source, name))
    values = picture_values(name, source)
    if values.dtype.kind == "f":
        check_range(name, values, "display values", "clip them, divide by 255 or give uint8")
        values = (np.clip(values, 0, 1) * 65535 + 0.5).astype(np.uint16)
    return check_pixels(name, Pixels(values, SRGB_SPACE, False))


def check_pixels(name: str, pixels: Pixels) -> Pixels:
    """Return a picture, or raise ValueError if :func:`check_size` refuses its size."""
    height, width = pixels.values.shape[:2]
    check_size(width, height, name)
    return pixels


def is_pil(source: object) -> TypeGuard[Image]:
    """Tell whether an object is a PIL picture of 8 bits; other PIL pictures are read as arrays of numbers."""
    return isinstance(source, Image) and source.mode not in ("I", "I;16", "F")


def is_picture(source: object) -> bool:
    """Tell whether an object is an array, a tensor or a PIL picture, whatever its shape."""
    return isinstance(source, np.ndarray | Tensor | Image) or hasattr(source, "__array_interface__")


def picture_values(name: str, source: object) -> Array:
    """Return the values of a picture, [H, W, 3], as uint8, uint16 or floating point; gray is repeated.

    Raises:
        ValueError: the picture has another shape or type.
    """
    values = array_of(name, source)
    shape = tuple(values.shape)
    if values.ndim == 2:
        values = values[..., None]
    if values.ndim != 3 or values.shape[2] not in (1, 3) or not values.size:
        remedy = ""
        if values.ndim == 3 and values.shape[2] == 4:
            remedy = "; leave alpha out: a[..., :3]"
        elif values.ndim == 3 and values.shape[0] in (1, 3):
            remedy = "; put the channels last: np.moveaxis(a, 0, -1)"
        raise ValueError(f"{name}: an array {list(shape)}, expected [H, W, 3] or gray [H, W]{remedy}.")
    if values.dtype.kind != "f" and values.dtype not in (np.uint8, np.uint16):
        raise ValueError(
            f"{name}: values of type {values.dtype}, expected uint8, uint16 or floating point; convert them."
        )
    return np.repeat(values, 3, -1) if values.shape[-1] == 1 else values


def check_range(name: str, values: Array, what: str, remedy: str, low: float = 0.0) -> None:
    """Raise ValueError for values that are not finite or leave [low, 1]; `what` says in errors what they are."""
    if not np.isfinite(values).all():
        count = np.count_nonzero(~np.isfinite(values))
        raise ValueError(f"{name}: {count:,} values are NaN or infinite, expected finite {what}; replace them.")
    if values.size and not (low - _SLACK <= values.min() and values.max() <= 1 + _SLACK):
        raise ValueError(
            f"{name}: {what} from {values.min():.4g} to {values.max():.4g}, expected {low:g} to 1; {remedy}."
        )
