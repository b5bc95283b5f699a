"""Pictures in memory: arrays, tensors, PIL's, functions of places; as files, which are read like any other.

So sizes, orientations, colours and checks are those of files. Arrays and tensors are [H, W, 3], or gray [H, W], rows
from the top. Integers of 8 or 16 bits are sRGB, floating-point values display values in [0, 1].
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from metapp.storage.images import write_png

SIDE = 512  # px of a picture that a function is evaluated for
EXPECTED = "a path, a picture (of PIL, or an array or tensor [H, W, 3])"
_SLACK = 1e-3  # by which rounding may leave [0, 1]

Array = NDArray[Any]
Function = Callable[[Array], Any]


def to_file(source: object, name: str, folder: Path, observe: str) -> Path:
    """Write a texture in memory as an image file.

    Args:
        source: a picture, or f(xy) -> display values in [0, 1], [N, 3] or gray [N], at places xy [N, 2] in [0, 1),
            float32 arrays, x to the right and y down.
        name: of the file.
        folder: where to.
        observe: what fits see; of no use here.

    Raises:
        ValueError: neither of these; values of another shape or out of range.
    """
    if callable(source):
        return write_picture(name, evaluated(name, source, texel_places(SIDE)), folder)
    if is_picture(source):
        return write_picture(name, source, folder)
    raise ValueError(f"{name}: {type(source).__name__}, expected {EXPECTED} or a function f(xy).")


def is_picture(source: object) -> bool:
    """Whether something is an array, a tensor or a picture of PIL, whatever its shape."""
    from PIL.Image import Image

    return isinstance(source, np.ndarray | Tensor | Image) or hasattr(source, "__array_interface__")


def write_picture(name: str, source: object, folder: Path) -> Path:
    """Write a picture as <folder>/<name>.png; PIL's with EXIF and colour profile.

    Raises:
        ValueError: no picture: another shape or type, values out of range.
    """
    from PIL.Image import Image

    path = folder / f"{name}.png"
    if isinstance(source, Image) and source.mode not in ("I", "F"):
        _write_pil(name, source, path)
        return path
    values = planes_of(name, source)
    if values.dtype.kind == "f":
        check_range(name, values, "display values", "clip them, divide by 255 or give uint8")
    bits = 8 if values.dtype == np.uint8 else 16
    write_png(torch.from_numpy(fractions(values)), {"encoding": "sRGB"}, path, bits)
    return path


def _write_pil(name: str, source: Any, path: Path) -> None:
    try:
        if source.mode not in ("L", "LA", "RGB", "RGBA", "I;16"):
            source = source.convert("RGBA" if "transparency" in source.info else "RGB")
        source.save(path, exif=source.getexif() or None, compress_level=1)
    except (OSError, ValueError) as error:  # PIL decodes when it must
        raise ValueError(f"{name}: a picture that PIL cannot decode ({error}), expected a whole one.") from None


def planes_of(name: str, source: object) -> Array:
    """The values of a picture, [H, W, 1 or 3]: uint8, uint16, or float.

    Raises:
        ValueError: another shape or type.
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
    return values


def fractions(values: Array) -> Array:
    """Integers over their greatest value, floats as they are; float64."""
    return values / (1 if values.dtype.kind == "f" else np.iinfo(values.dtype).max)


def check_range(name: str, values: Array, what: str, remedy: str, low: float = 0.0) -> None:
    """Refuse values that are not finite or outside [low, 1].

    Raises:
        ValueError: some are.
    """
    if not np.isfinite(values).all():
        count = np.count_nonzero(~np.isfinite(values))
        raise ValueError(f"{name}: {count:,} values are NaN or infinite, expected finite {what}; replace them.")
    if values.size and not (low - _SLACK <= values.min() and values.max() <= 1 + _SLACK):
        raise ValueError(
            f"{name}: {what} from {values.min():.4g} to {values.max():.4g}, expected {low:g} to 1; {remedy}."
        )


def array_of(name: str, source: object) -> Array:
    """Numbers of any kind, an array, a tensor on any device, nested lists, as a numpy array.

    Raises:
        ValueError: no numbers.
    """
    if isinstance(source, Tensor):
        tensor = source.detach().cpu()
        return (tensor.float() if tensor.dtype == torch.bfloat16 else tensor).numpy()
    try:
        values = np.asarray(source)
    except Exception:  # whatever an object of another library raises
        values = np.asarray(None)
    if values.dtype.kind not in "uif":
        found = f"an array of {values.dtype}" if values.ndim else type(source).__name__
        raise ValueError(f"{name}: {found}, expected an array of numbers.")
    return values


def texel_places(side: int) -> Array:
    """The centres of side x side texels, [side * side, 2] in [0, 1), row by row, float32: x to the right, y down."""
    centres = (np.arange(side, dtype=np.float32) + 0.5) / side
    return np.stack(np.meshgrid(centres, centres), -1).reshape(-1, 2)


def evaluated(name: str, function: Function, places: Array) -> Array:
    """A picture [S, S, 1 or 3] of a function's values at `texel_places`."""
    side = round(len(places) ** 0.5)
    values = rows_of(name, function(places), len(places))
    return values.reshape(side, side, -1)


def rows_of(name: str, returned: object, count: int) -> Array:
    """What a function returned for so many places, [count, 1 or 3].

    Raises:
        ValueError: another shape or type.
    """
    values = array_of(f"{name}'s values", returned)
    if values.shape not in ((count,), (count, 1), (count, 3)):
        raise ValueError(f"{name}: values {list(values.shape)}, expected [{count}, 3]: RGB of each, or gray [{count}].")
    return values.reshape(count, -1)
