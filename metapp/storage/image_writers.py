"""Writers of pictures: PNG, JPEG and EXR, each written whole or not at all, and pictures inside of pages.

What a picture shows, and in which colour space it is, is decided by who writes it.
"""

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

PNG_COMPRESSION_LEVEL = 2  # of deflation, whose highest level is 9
JPEG_QUALITY = 95  # of 100; mixed photographs err by 0.6/255, at 85 by 1.0/255
PNG_AVERAGE_FILTER = 64  # libpng's number of the filter that predicts a pixel by the mean of its left and upper pixel


def write_png(pixels: Tensor, texts: Mapping[str, str], path: Path, bits: int = 8) -> None:
    """Write a picture as PNG.

    Args:
        pixels: the values, [H, W, 1 or 3], which are clamped to [0, 1].
        texts: texts that the file holds, by their keys; `encoding` is "sRGB", or "linear" for data that are no colours.
        path: the file to write.
        bits: number of bits a channel, 8 or 16.

    Raises:
        OSError: the file cannot be written; the message names the folder.
    """
    levels = np.clip(pixels.numpy(), 0, 1) * (2**bits - 1) + 0.5
    attributes = {
        # a program that honours the colour space of a PNG must not decode roughness and normals like colours
        "oiio:ColorSpace": "data" if texts["encoding"] == "linear" else "sRGB",
        # the library's defaults take twice the time, and make files of noisy pictures only 2 % smaller
        "png:compressionLevel": PNG_COMPRESSION_LEVEL,
        "png:filter": PNG_AVERAGE_FILTER,
        **texts,
    }
    _write_image(levels.astype(np.uint8 if bits == 8 else np.uint16), attributes, f"uint{bits}", path)


def write_exr(pixels: Tensor, path: Path, *, half: bool | None = None) -> None:
    """Write linear values of any range as EXR.

    Args:
        pixels: the values, [H, W, 1 or 3].
        path: the file to write.
        half: whether to write half floats. None chooses them for radiance whose maximum they can hold and is so large
            that dark parts lose no digits.

    Raises:
        OSError: the file cannot be written; the message names the folder.
    """
    values = pixels.numpy().astype(np.float32)
    if half is None:
        # with a maximum below 1, dark parts would lie where half floats lose digits
        half = bool(1 <= values.max() <= np.finfo(np.float16).max)
    _write_image(values, {"oiio:ColorSpace": "lin_rec709_scene"}, "half" if half else "float", path)


def write_jpeg(pixels: Tensor, path: Path, quality: int) -> None:
    """Write three channels that are no colours as JPEG, each compressed by itself.

    Args:
        pixels: the values, [H, W, 3], which are clamped to [0, 1].
        path: the file to write.
        quality: the quality, 1 to 100.

    Raises:
        OSError: the file cannot be written; the message names the folder.
    """
    image = to_8_bit_image(pixels.numpy())
    # OpenImageIO converts to luminance and chrominance, which at 95 doubles the errors of channels that are no colours
    write_atomically(path, lambda partial: image.save(partial, "JPEG", quality=quality, subsampling=0, keep_rgb=True))


def _write_image(values: np.ndarray, attributes: Mapping[str, str | int], pixel_type: str, path: Path) -> None:
    """Write an image by OpenImageIO.

    Args:
        values: the pixels, [H, W, C].
        attributes: entries of the file's header, by name.
        pixel_type: the type of the pixels in the file, as OpenImageIO names it.
        path: the file to write.
    """
    import OpenImageIO as oiio  # not above: the import takes 20 ms, and most fits of BRDFs write no such file

    image = oiio.ImageBuf(np.ascontiguousarray(values))
    for key, value in attributes.items():
        image.specmod().attribute(key, value)

    def write(partial: Path) -> None:
        if not image.write(str(partial), pixel_type):
            raise ValueError(f"{path}: not written ({image.geterror()}); is the disk full?")

    write_atomically(path, write)


def to_8_bit_image(display: np.ndarray) -> Image:
    """Convert display values [H, W, 1, 3 or 4], clamped to [0, 1], to a PIL image of 8 bits.

    >>> to_8_bit_image(np.full((2, 3, 3), 0.5)).getpixel((0, 0))
    (128, 128, 128)
    """
    pixels = (np.clip(display, 0, 1) * 255 + 0.5).astype(np.uint8)
    return pil.fromarray(pixels[..., 0] if pixels.shape[-1] == 1 else pixels)


def png_data_url(image: Image) -> str:
    """Return the data URL of a picture as PNG, by which a page holds the picture itself."""
    return _data_url(image, "png")


def jpeg_data_url(image: Image) -> str:
    """Return the data URL of a picture as JPEG, for pictures of photographs that are too large as PNG."""
    return _data_url(image, "jpeg", quality=JPEG_QUALITY, subsampling=0)  # channels may be data, and not colours


def _data_url(image: Image, form: str, **options: int) -> str:
    buffer = io.BytesIO()
    image.save(buffer, form, **options)
    return f"data:image/{form};base64,{base64.b64encode(buffer.getvalue()).decode()}"
