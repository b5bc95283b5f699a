"""Images: files, written whole or not at all, as PNG of 8 or 16 bits or EXR; pictures of 8 bits that pages hold."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from PIL import Image as pil
from PIL.Image import Image
from torch import Tensor

from metapp.storage.files import write_atomically

PNG_COMPRESSION_LEVEL = 2  # of 9, of deflation
PNG_AVERAGE_FILTER = 64  # libpng's filter by the average of the pixels left and above


def write_png(pixels: Tensor, texts: Mapping[str, str], path: Path, bits: int = 8) -> None:
    """Write a picture as PNG.

    Args:
        pixels: [H, W, 1 or 3]; clamped to [0, 1].
        texts: kept in the file by their keys; `encoding` is "sRGB" or, of data that are no colours, "linear".
        path: the file.
        bits: 8 or 16.

    Raises:
        OSError: it cannot be written; names the folder.
    """
    levels = np.clip(pixels.numpy(), 0, 1) * (2**bits - 1) + 0.5
    attributes = {
        # whoever honours a PNG's colour space would decode roughness and normals wrongly
        "oiio:ColorSpace": "data" if texts["encoding"] == "linear" else "sRGB",
        # the library's own take twice the time, for files of noisy pictures 2 % smaller
        "png:compressionLevel": PNG_COMPRESSION_LEVEL,
        "png:filter": PNG_AVERAGE_FILTER,
        **texts,
    }
    _write(levels.astype(np.uint8 if bits == 8 else np.uint16), attributes, f"uint{bits}", path)


def write_exr(pixels: Tensor, path: Path, *, half: bool | None = None) -> None:
    """Write linear values [H, W, 1 or 3] of any range as EXR: half floats if they are precise enough.

    Args:
        pixels: to write.
        path: the file.
        half: half floats or not; None: of radiance, if its maximum says that no dark part loses digits.

    Raises:
        OSError: it cannot be written; names the folder.
    """
    values = pixels.numpy().astype(np.float32)
    if half is None:
        half = bool(1 <= values.max() <= np.finfo(np.float16).max)  # below, dark parts would lose digits
    _write(values, {"oiio:ColorSpace": "lin_rec709_scene"}, "half" if half else "float", path)


def _write(values: np.ndarray, attributes: Mapping[str, str | int], form: str, path: Path) -> None:
    import OpenImageIO as oiio  # here: most fits of BRDFs write no such file, and it takes 20 ms

    image = oiio.ImageBuf(np.ascontiguousarray(values))
    for key, value in attributes.items():
        image.specmod().attribute(key, value)

    def write(partial: Path) -> None:
        if not image.write(str(partial), form):
            raise ValueError(f"{path}: not written ({image.geterror()}); is the disk full?")

    write_atomically(path, write)


def to_8_bit_image(display: np.ndarray) -> Image:
    """Display values [H, W, 1, 3 or 4], clamped to [0, 1], as a picture of PIL.

    >>> in_8_bits(np.full((2, 3, 3), 0.5)).getpixel((0, 0))
    (128, 128, 128)
    """
    pixels = (np.clip(display, 0, 1) * 255 + 0.5).astype(np.uint8)
    return pil.fromarray(pixels[..., 0] if pixels.shape[-1] == 1 else pixels)


def png_data_url(image: Image) -> str:
    """The address of a picture that is part of a page, as PNG."""
    buffer = io.BytesIO()
    image.save(buffer, "PNG")
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"
