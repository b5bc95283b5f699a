"""Where camera and flash were for several photos of one flat material: text files beside the photos."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from data_tools.readers.flash_places import CAMERA, LIGHT, SIZE
from metapp.storage.files import read_text

LARGEST_CM = 1e5  # a side of a patch
FARTHEST = 1000.0  # sides that camera and flash are away


class Places(NamedTuple):
    """Places for N photos, in half sides of the patch: origin in its centre, x right, y up, z along its normal.

    Attributes:
        camera: [N, 3].
        light: of the flash, [N, 3].
    """

    camera: Tensor
    light: Tensor


def read_places(folder: Path, photos: int) -> Places:
    """The places that a folder gives for so many photos, in the order of their names.

    CAMERA and LIGHT hold a line "x,y,z" in cm for each photo, SIZE the patch's side in cm.

    Raises:
        ValueError: a file is missing, malformed or of another count; a place is not above the patch.
    """
    side = _rows(folder / SIZE, 1, 1)[0][0]
    if not 1 / LARGEST_CM <= side <= LARGEST_CM:
        expected = f"the patch's side in cm, {1 / LARGEST_CM:g} to {LARGEST_CM:g}"
        raise ValueError(f"{folder / SIZE}: {side:g}, expected {expected}; measure it.")
    return Places(*(_above(folder / name, photos, FARTHEST * side) / (side / 2) for name in (CAMERA, LIGHT)))


def _above(path: Path, photos: int, farthest: float) -> Tensor:
    """Places [photos, 3] in cm, all above the patch and no further from it than that."""
    places = torch.tensor(_rows(path, photos, 3), dtype=torch.float64)
    for number, place in enumerate(places.tolist(), 1):
        if not max(map(abs, place)) <= farthest:
            raise ValueError(
                f"{path}: place {number} is {max(map(abs, place)):g} cm away, expected {farthest:g} at most, "
                f"{FARTHEST:g} sides of the patch; write cm."
            )
    places = places.float()
    for number, height in enumerate(places[:, 2].tolist(), 1):
        if height <= 0:
            raise ValueError(
                f"{path}: place {number} has z {height:g} cm, expected above 0; let z point at the camera."
            )
    return places


def _rows(path: Path, count: int, width: int) -> list[list[float]]:
    """So many lines of so many finite numbers, parted by commas; blank lines do not count."""
    try:
        lines = [line for line in read_text(path).splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: cannot be read as text, expected lines in cm: {count}; write it.") from error
    if len(lines) != count:
        raise ValueError(f"{path}: {len(lines)} lines, expected {count}; give one for each photo, or one side.")
    return [_numbers(path, line, width) for line in lines]


def _numbers(path: Path, line: str, width: int) -> list[float]:
    try:
        numbers = [float(word) for word in line.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != width or not all(map(math.isfinite, numbers)):
        raise ValueError(
            f"{path}: line {line!r}, expected {width} finite number{'s' * (width != 1)}, parted by commas; mend it."
        )
    return numbers
