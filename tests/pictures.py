"""Image files of all kinds, whole and damaged, and how every refusal of one looks."""

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

KINDS = {"uint8": "uint8", "uint16": "uint16", "float32": "float"}

# by EXIF's orientation, what a camera stores that is held so: the picture is turned back
STORED: dict[int, Callable[[np.ndarray], np.ndarray]] = {
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


def write(path: Path, values: np.ndarray, kind: str = "", names: tuple[str, ...] = (), **attributes: Any) -> Path:
    """An image file of values [height, width, channels], stored as they are or as `kind`.

    Attributes are as OpenImageIO calls them, `_` for `:`.
    """
    spec = oiio.ImageSpec(values.shape[1], values.shape[0], values.shape[2], kind or KINDS[values.dtype.name])
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
    """An EXR file of parts.

    Args:
        path: the file.
        parts: each one's name and values [height, width, channels]; the channels are called after a colon, parted by
            spaces: "beauty:R G B". A single part "deep" is deep, without samples.
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
    """An image file of planes [C, H, W] in [0, 1]."""
    return write(path, planes.permute(1, 2, 0).float().numpy(), kind)


def planes(values: np.ndarray) -> Tensor:
    """Values [height, width, channels] as [channels, height, width]."""
    return torch.from_numpy(np.ascontiguousarray(values.transpose(2, 0, 1)))


def noise(height: int, width: int, channels: int = 3, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, channels), dtype=np.uint8)


def photograph(path: Path, seed: int = 0, side: int = 48) -> Path:
    """An image file of noise."""
    return write(path, noise(side, side, seed=seed))


def environment(path: Path, seed: int = 0, **attributes: str) -> Path:
    """A small lat-long map of noise."""
    return write(path, np.random.default_rng(seed).uniform(0.1, 9, (32, 64, 3)).astype(np.float32), **attributes)


def truncated(path: Path, keep: float = 0.5) -> Path:
    os.truncate(path, int(path.stat().st_size * keep))
    return path


def text(path: Path) -> Path:
    path.write_text("a texture, in words\n")
    return path


def profile(matrix: np.ndarray, power: float, name: str = "a space", kind: bytes = b"RGB ") -> bytes:
    """An ICC profile, version 2.

    Args:
        matrix: [3, 3], linear colours to XYZ of D50.
        power: of the encoding.
        name: its description.
        kind: "RGB " or, of a power alone, "GRAY"; of others there is no conversion.
    """
    text = name.encode() + b"\0"
    tags = {b"desc": b"desc" + struct.pack(">4xI", len(text)) + text + bytes(78)}
    curve = b"curv" + struct.pack(">4xIH", 1, round(power * 256))
    for number, part in enumerate((b"r", b"g", b"b") if kind == b"RGB " else ()):
        xyz = struct.pack(">4x3i", *(round(65536 * each) for each in matrix[:, number]))
        tags |= {part + b"XYZ": b"XYZ " + xyz, part + b"TRC": curve}
    tags |= {b"kTRC": curve} if kind == b"GRAY" else {}
    tags[b"wtpt"] = b"XYZ " + struct.pack(">4x3i", *(round(65536 * each) for each in (0.9642, 1, 0.8249)))
    table, body, start = b"", b"", 132 + 12 * len(tags)
    for key, content in tags.items():
        table += struct.pack(">4sII", key, start + len(body), len(content))
        body += content + bytes(-len(content) % 4)
    head = struct.pack(
        ">I4sI4s4s4s12s4s", start + len(body), b"", 0x2100000, b"mntr", kind, b"XYZ ", bytes(12), b"acsp"
    )
    light = struct.pack(">3i", *(round(65536 * each) for each in (0.9642, 1, 0.8249)))
    return head.ljust(68, b"\0") + light + bytes(48) + struct.pack(">I", len(tags)) + table + body


def png_with(file: bytes, chunks: dict[bytes, bytes]) -> bytes:
    """A PNG file with more chunks after its header."""
    more = b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks.items()
    )
    return file[:33] + more + file[33:]


def check_refused(read: Callable[[Path], object], path: Path, message: str) -> None:
    """One line that names the path, once, and holds the message."""
    with pytest.raises(ValueError) as error:  # noqa: PT011  (the message is looked at below)
        read(path)
    line = str(error.value)
    assert line.count(str(path)) == 1
    assert message in line
    assert "\n" not in line
    assert line.endswith(".")
