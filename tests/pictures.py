"""Image files of all kinds, whole and damaged, and how every refusal of one looks."""

import os
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
        typed = (oiio.TypeDesc(f"float[{len(value)}]"), value) if isinstance(value, tuple) else (value,)
        spec.attribute(name.replace("_", ":"), *typed)
    path.parent.mkdir(parents=True, exist_ok=True)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(np.ascontiguousarray(values))
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


def check_refused(read: Callable[[Path], object], path: Path, message: str) -> None:
    """One line that names the path, once, and holds the message."""
    with pytest.raises(ValueError) as error:  # noqa: PT011  (the message is looked at below)
        read(path)
    line = str(error.value)
    assert line.count(str(path)) == 1
    assert message in line
    assert "\n" not in line
    assert line.endswith(".")
