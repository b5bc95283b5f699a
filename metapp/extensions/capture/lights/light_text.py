"""The light's directions written as a text `.lp`, beside it the places of the balls and a picture of what was found."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from data_tools.readers.ball_places import ball_places_path, write_ball_places
from data_tools.readers.colours import LINEAR_SPACE, Floats
from data_tools.readers.image_files import Pixels
from metapp.extensions.capture.hand_photos import write_outlines
from metapp.extensions.capture.lights.lit_photos import MeasuredLights
from metapp.storage.files import write_bytes
from metapp.storage.folders import FOUND_FOLDER

_MARK_PX = 3.0  # half the side of the mark on a highlight, in px of the picture


def write_lights(lights: MeasuredLights, names: Sequence[str], path: Path, *, shows_balls: bool) -> None:
    """Write the light's directions, the places of the balls, and the picture FOUND_FOLDER/NAME.png.

    Args:
        lights: what was found.
        names: the names of photographs to write, one for each photograph; those without a direction are left out.
        path: the text of directions.
        shows_balls: whether the balls are in the photographs of these names.

    Raises:
        OSError: a file cannot be written.
    """
    if shows_balls:
        write_ball_places(path, [lit_ball.ball[:3] for lit_ball in lights.balls], *lights.shape)
    else:
        ball_places_path(path).unlink(missing_ok=True)
    _write_found(lights, path.parent / FOUND_FOLDER / f"{path.stem}.png")
    write_bytes(path, light_text(lights, names).encode())


def light_text(lights: MeasuredLights, names: Sequence[str]) -> str:
    """Return the text of the light's directions: the number of photographs, then a line "name x y z" for each."""
    lines = [
        " ".join([name, *(f"{coordinate:.6f}" for coordinate in direction)])
        for name, direction in zip(names, lights.lamps.directions, strict=True)
        if np.isfinite(direction).all()
    ]
    return "\n".join([f"{len(lines)}", *lines, ""])


def _write_found(lights: MeasuredLights, path: Path) -> None:
    """Write the brightest values of all photographs with the contours of balls, and marks on highlights that count."""
    shrunk = lights.brightest.shape[1] / lights.shape[1]
    angles = np.linspace(0, 2 * np.pi, 181)
    outlines: list[tuple[Floats, str]] = []
    for lit_ball in lights.balls:
        outlines.append((shrunk * lit_ball.ball.to_px(np.stack([np.cos(angles), np.sin(angles)])).T, "lime"))
        for highlight in lit_ball.highlights:
            if not highlight.fault:
                mark = _MARK_PX * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
                outlines.append((shrunk * highlight.peak_px + mark, "magenta"))
    write_outlines(Pixels(lights.brightest, LINEAR_SPACE, False), outlines, path)
