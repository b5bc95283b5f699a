"""Pictures as JPEG and PNG files in memory."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import OpenImageIO as oiio


def jpeg(picture: np.ndarray, quality: int) -> bytes:
    """A JPEG of a picture [H, W, 1 or 3] in [0, 1], quality 1 to 100, colours as fine as brightness."""
    settings = {"Compression": f"jpeg:{quality}", "jpeg:subsampling": "4:4:4"}
    return _written(picture, ".jpg", "uint8", settings)


def png(picture: np.ndarray, bits: int) -> bytes:
    """A PNG of a picture [H, W, 1 or 3] in [0, 1], of 8 or 16 bits, compressed as far as it goes."""
    return _written(picture, ".png", f"uint{bits}", {"png:compressionLevel": 9, "png:filter": 0xF8})


def decoded(file: bytes, suffix: str) -> np.ndarray:
    """The picture [H, W, 1 or 3] of a file, in [0, 1]."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"picture{suffix}")
        path.write_bytes(file)
        pixels = oiio.ImageBuf(str(path)).get_pixels("float")
    assert pixels is not None
    return pixels


def _written(picture: np.ndarray, suffix: str, kind: str, settings: Mapping[str, str | int]) -> bytes:
    spec = oiio.ImageSpec(picture.shape[1], picture.shape[0], picture.shape[2], kind)
    for key, value in settings.items():
        spec.attribute(key, value)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"picture{suffix}")
        output = oiio.ImageOutput.create(str(path))
        assert output is not None, suffix
        done = output.open(str(path), spec) and output.write_image(np.ascontiguousarray(picture, np.float32))
        if not (output.close() and done):
            raise OSError(f"a picture as {suffix}: {output.geterror()}")
        return path.read_bytes()
