"""The places of balls in photographs by a camera that stands still, which are no part of the material.

Glossy balls tell the light's directions. Where they are stands in a text beside the text of directions: the width and
the height of the photographs in px, then for each ball a line with x, y (from the upper left corner) and radius in px.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metapp.storage.files import read_text, write_bytes

BALL_PLACES_SUFFIX = ".balls"


def ball_places_path(light_text: Path) -> Path:
    """Return where the places of balls stand that belong to a text of light directions."""
    return light_text.with_suffix(BALL_PLACES_SUFFIX)


def write_ball_places(light_text: Path, balls: Sequence[Sequence[float]], height: int, width: int) -> None:
    """Write the places of balls beside a text of light directions.

    Args:
        light_text: the text of light directions.
        balls: x, y and radius of each ball, in px.
        height: the height of the photographs in px.
        width: the width of the photographs in px.

    Raises:
        OSError: the file cannot be written.
    """
    lines = [f"{width} {height}", *(" ".join(f"{number:.2f}" for number in ball) for ball in balls), ""]
    write_bytes(ball_places_path(light_text), "\n".join(lines).encode())


def mask_of_balls(light_text: Path, height: int, width: int) -> NDArray[np.bool_]:
    """Return where balls are in photographs, [height, width]; nowhere if no places stand beside the text of lights.

    Args:
        light_text: the text of light directions.
        height: the height of the mask in px; the photographs may have been larger when the balls were found.
        width: the width of the mask in px.

    Raises:
        ValueError: the places cannot be read, or a line is malformed.
    """
    path, mask = ball_places_path(light_text), np.zeros((height, width), bool)
    if not path.is_file():
        return mask
    try:
        first, *lines = [
            [float(word) for word in line.split()] for line in read_text(path).splitlines() if line.strip()
        ]
    except (OSError, ValueError) as error:  # UnicodeDecodeError is a ValueError, and so is a missing first line
        raise ValueError(f"{path}: cannot be read as numbers, expected places of balls; write it again.") from error
    is_valid = len(first) == 2 and min(first) > 0 and all(len(ball) == 3 and ball[2] > 0 for ball in lines)
    if not (is_valid and all(map(math.isfinite, [*first, *(number for ball in lines for number in ball)]))):
        expected = "expected 'width height', then 'x y radius' for each ball"
        raise ValueError(f"{path}: other numbers than places of balls, {expected}; write it again.")
    x = (np.arange(width) + 0.5) * (first[0] / width)
    y = (np.arange(height)[:, None] + 0.5) * (first[1] / height)
    for ball in lines:
        mask |= (x - ball[0]) ** 2 + (y - ball[1]) ** 2 <= ball[2] ** 2
    return mask
