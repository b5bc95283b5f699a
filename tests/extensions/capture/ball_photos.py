"""Photographs of perfect mirror balls under maps in closed form."""

from pathlib import Path

import numpy as np
import torch

from data_tools.readers.colours import LINEAR_SPACE
from data_tools.readers.image_files import Pixels
from metapp.appearance.colour import linear_to_srgb
from metapp.extensions.capture.ball.ball_geometry import Ball, Floats, disc_to_directions
from metapp.storage.image_writers import write_png


def light(towards: Floats) -> Floats:
    """A smooth map, radiance [3, ...] in directions [3, ...]: 0.1 to 0.9."""
    x, y, z = towards
    return np.stack([0.5 + 0.2 * x + 0.2 * y * z, 0.5 + 0.3 * z, 0.45 + 0.25 * y - 0.1 * x * z])


def detailed(towards: Floats) -> Floats:
    """A map with some detail, as a room has, radiance [3, ...]."""
    x, y, z = towards
    waves = np.sin(9 * x + 2 * y) * np.sin(7 * y - 3 * z) * np.cos(5 * z + 4 * x)
    return light(towards) * (0.6 + 0.5 * np.tanh(4 * waves))


def places_of(ball: Ball, height: int, width: int, many: int = 2) -> Floats:
    """Places [2, many * height, many * width] in the ball's disc of a photograph's pixels."""
    x, y = np.meshgrid((np.arange(many * width) + 0.5) / many, (np.arange(many * height) + 0.5) / many)
    centre = np.array([ball.x - ball.lens.x, ball.y - ball.lens.y, ball.lens.focal])
    right = np.cross([0.0, 1.0, 0.0], centre)
    up = np.cross(right, centre)
    ray = np.stack([x - ball.lens.x, y - ball.lens.y, np.full(x.shape, ball.lens.focal)])
    along = centre @ centre / np.einsum("i,ihw->hw", centre, ray)
    return np.stack(
        [
            np.einsum("i,ihw->hw", axis, ray) * along / ball.radius
            for axis in (right / np.linalg.norm(right), up / np.linalg.norm(up))
        ]
    )


def photograph(ball: Ball, height: int, width: int, around: Floats | float = 0.05, lit=light) -> Floats:
    """Linear RGB [3, height, width] of a mirror ball before something else."""
    places = places_of(ball, height, width)
    behind = np.kron(np.broadcast_to(around, (height, width)), np.ones((2, 2)))
    values = np.where(np.hypot(*places) < 1, lit(disc_to_directions(places, ball.half_angle_rad)), behind)
    return values.reshape(3, height, 2, width, 2).mean((2, 4))


def busy(height: int, width: int, seed: int) -> Floats:
    """A background of boxes, brighter or darker than what balls mirror at their contour, [height, width]."""
    rng = np.random.default_rng(seed)
    result = np.full((height, width), 0.8)
    for _ in range(40):
        y, x = rng.integers(height), rng.integers(width)
        height_, width_ = rng.integers(10, 80, 2)
        result[y : y + height_, x : x + width_] = rng.choice([0.02, 0.04, 0.6, 0.7, 0.9, 1.0])
    return result


def taken(linear: Floats) -> Pixels:
    """A photograph in memory of linear RGB [3, height, width] in [0, 1]."""
    return Pixels(linear.transpose(1, 2, 0).astype(np.float32), LINEAR_SPACE, False)


def written(path: Path, linear: np.ndarray) -> Path:
    """A PNG of linear RGB [3, height, width] in [0, 1]."""
    display = linear_to_srgb(torch.from_numpy(linear).clamp(0, 1)).permute(1, 2, 0).float()
    write_png(display, {"encoding": "sRGB"}, path)
    return path
