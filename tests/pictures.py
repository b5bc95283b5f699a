"""Writers of image files of many kinds, whole and damaged, and a check that a reader refuses a file in one line."""

import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
import torch
from torch import Tensor

OIIO_TYPES = {"uint8": "uint8", "uint16": "uint16", "float32": "float"}

# for each orientation of EXIF, how a camera stores an upright picture; readers turn it back
STORED_BY_ORIENTATION: dict[int, Callable[[np.ndarray], np.ndarray]] = {
    1: lambda values: values,
    2: np.fliplr,
    3: lambda values: np.rot90(values, 2),
    4: np.flipud,
    5: lambda values: values.swapaxes(0, 1),
    6: lambda values: np.rot90(values, 1),
    7: lambda values: np.rot90(values, 2).swapaxes(0, 1),
    8: lambda values: np.rot90(values, -1),
}
P3_TO_SRGB = torch.tensor(  # linear colours
    [[1.22494, -0.22494, 0.0], [-0.04206, 1.04206, 0.0], [-0.01964, -0.07864, 1.09827]], dtype=torch.float64
)


def write_image(path: Path, values: np.ndarray, kind: str = "", names: tuple[str, ...] = (), **attributes: Any) -> Path:
    """Write an image file of values [height, width, channels], stored as they are or as `kind`, and return its path.

    Attributes have their names in OpenImageIO, with `_` for `:`.
    """
    spec = oiio.ImageSpec(values.shape[1], values.shape[0], values.shape[2], kind or OIIO_TYPES[values.dtype.name])
    spec.channelnames = names or spec.channelnames
    if str(spec.format).startswith("uint"):
        spec.attribute("oiio:UnassociatedAlpha", 1)
    for name, value in attributes.items():
        kind = {tuple: "float", bytes: "uint8"}.get(type(value))
        typed = (
            (oiio.TypeDesc(f"{kind}[{len(value)}]"), np.array(list(value), kind.replace("float", "f4")))
            if kind
            else (value,)
        )
        spec.attribute(name.replace("_", ":"), *typed)
    path.parent.mkdir(parents=True, exist_ok=True)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(np.ascontiguousarray(values))
    output.close()
    return path


def write_exr(path: Path, *parts: tuple[str, np.ndarray], window: tuple[int, int, int, int] | None = None) -> Path:
    """Write an EXR file of parts and return its path.

    Args:
        path: the file.
        parts: name and values [height, width, channels] of each part. The name may be followed by a colon and the names
            of its channels, as in "beauty:R G B". A single part called "deep" is deep, without samples.
        window: height, width of the display window, and row and column in it of the first pixel; None: all.
    """
    specs = []
    for name, values in parts:
        part, _, names = name.partition(":")
        spec = oiio.ImageSpec(values.shape[1], values.shape[0], values.shape[2], "float")
        spec.channelnames = tuple(names.split()) if names else spec.channelnames
        spec.deep = part == "deep"
        if len(parts) > 1:
            spec.attribute("oiio:subimagename", part)
        if window:
            spec.full_height, spec.full_width, spec.y, spec.x = window
        specs.append(spec)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), tuple(specs)) if len(specs) > 1 else output.open(str(path), specs[0])
    for number, (spec, (_, values)) in enumerate(zip(specs, parts, strict=True)):
        assert not number or output.open(str(path), spec, "AppendSubimage")
        if spec.deep:
            samples = oiio.DeepData()
            samples.init(
                spec.width * spec.height, spec.nchannels, (oiio.TypeFloat,) * spec.nchannels, spec.channelnames
            )
            assert output.write_deep_image(samples)
        else:
            assert output.write_image(np.ascontiguousarray(values, np.float32))
    output.close()
    return path


def write_planes(path: Path, planes: Tensor, kind: str = "uint8") -> Path:
    """Write an image file of planes [C, H, W] in [0, 1] and return its path."""
    return write_image(path, planes.permute(1, 2, 0).float().numpy(), kind)


def channels_first(values: np.ndarray) -> Tensor:
    """Return values [height, width, channels] as [channels, height, width]."""
    return torch.from_numpy(np.ascontiguousarray(values.transpose(2, 0, 1)))


def noise_image(height: int, width: int, channels: int = 3, seed: int = 0) -> np.ndarray:
    """Return random uint8 values [height, width, channels]."""
    return np.random.default_rng(seed).integers(0, 256, (height, width, channels), dtype=np.uint8)


def write_noise_photo(path: Path, seed: int = 0, side: int = 48) -> Path:
    """Write a square image file of noise and return its path."""
    return write_image(path, noise_image(side, side, seed=seed))


def write_noise_map(path: Path, seed: int = 0, **attributes: str) -> Path:
    """Write a lat-long map of noise, 64 x 32 texels, and return its path."""
    return write_image(path, np.random.default_rng(seed).uniform(0.1, 9, (32, 64, 3)).astype(np.float32), **attributes)


def truncate_file(path: Path, keep: float = 0.5) -> Path:
    """Cut a file to a share of its length and return its path."""
    os.truncate(path, int(path.stat().st_size * keep))
    return path


def write_text(path: Path) -> Path:
    """Write a text, which is no image, and return its path."""
    path.write_text("a texture, in words\n")
    return path


def icc_profile(matrix: np.ndarray, power: float, name: str = "a space", kind: bytes = b"RGB ") -> bytes:
    """Return an ICC profile of version 2.

    Args:
        matrix: [3, 3], from linear colours to XYZ under D50.
        power: the exponent of the encoding.
        name: the description of the profile.
        kind: "RGB ", or "GRAY" for a profile of the power alone; other kinds get no data for a conversion.
    """
    text = name.encode() + b"\0"
    tags = {b"desc": b"desc" + struct.pack(">4xI", len(text)) + text + bytes(78)}
    curve = b"curv" + struct.pack(">4xIH", 1, round(power * 256))
    for number, part in enumerate((b"r", b"g", b"b") if kind == b"RGB " else ()):
        xyz = struct.pack(">4x3i", *(round(65536 * value) for value in matrix[:, number]))
        tags |= {part + b"XYZ": b"XYZ " + xyz, part + b"TRC": curve}
    tags |= {b"kTRC": curve} if kind == b"GRAY" else {}
    tags[b"wtpt"] = b"XYZ " + struct.pack(">4x3i", *(round(65536 * value) for value in (0.9642, 1, 0.8249)))
    table, body, start = b"", b"", 132 + 12 * len(tags)
    for key, content in tags.items():
        table += struct.pack(">4sII", key, start + len(body), len(content))
        body += content + bytes(-len(content) % 4)
    head = struct.pack(
        ">I4sI4s4s4s12s4s", start + len(body), b"", 0x2100000, b"mntr", kind, b"XYZ ", bytes(12), b"acsp"
    )
    light = struct.pack(">3i", *(round(65536 * value) for value in (0.9642, 1, 0.8249)))
    return head.ljust(68, b"\0") + light + bytes(48) + struct.pack(">I", len(tags)) + table + body


def add_png_chunks(file: bytes, chunks: dict[bytes, bytes]) -> bytes:
    """Return a PNG file with more chunks after its header."""
    added = b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks.items()
    )
    return file[:33] + added + file[33:]


def assert_refused_in_one_line(read: Callable[[Path], object], path: Path, message: str) -> None:
    """Assert that a reader refuses a file by one line that names the path once and holds the message."""
    with pytest.raises(ValueError) as error:  # noqa: PT011  (the message is looked at below)
        read(path)
    line = str(error.value)
    assert line.count(str(path)) == 1
    assert message in line
    assert "\n" not in line
    assert line.endswith(".")
