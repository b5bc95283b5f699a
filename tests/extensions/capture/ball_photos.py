"""Photographs of perfect mirror balls under environment maps in closed form, which captured maps are compared with."""

from pathlib import Path

import numpy as np
import torch

from data_tools.readers.colours import LINEAR_SPACE
from data_tools.readers.image_files import Pixels
from metapp.appearance.colour import linear_to_srgb
from metapp.extensions.capture.ball.ball_geometry import Ball, Floats, disc_to_directions
from metapp.storage.image_writers import write_png


def smooth_light(towards: Floats) -> Floats:
    """Return the radiance [3, ...] of a smooth environment map in directions [3, ...], between 0.1 and 0.9."""
    x, y, z = towards
    return np.stack([0.5 + 0.2 * x + 0.2 * y * z, 0.5 + 0.3 * z, 0.45 + 0.25 * y - 0.1 * x * z])


def detailed_light(towards: Floats) -> Floats:
    """Return the radiance [3, ...] of an environment map with as much detail as a room, in directions [3, ...]."""
    x, y, z = towards
    waves = np.sin(9 * x + 2 * y) * np.sin(7 * y - 3 * z) * np.cos(5 * z + 4 * x)
    return smooth_light(towards) * (0.6 + 0.5 * np.tanh(4 * waves))


def positions_in_disc(ball: Ball, height: int, width: int, subdivisions: int = 2) -> Floats:
    """Return where the points of a photograph lie in the ball's disc, in radii of the disc.

    Each pixel has `subdivisions` by `subdivisions` points: [2, subdivisions * height, subdivisions * width].
    """
    x, y = np.meshgrid(
        (np.arange(subdivisions * width) + 0.5) / subdivisions, (np.arange(subdivisions * height) + 0.5) / subdivisions
    )
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


def photograph_ball(
    ball: Ball, height: int, width: int, background: Floats | float = 0.05, light=smooth_light
) -> Floats:
    """Return a photograph of a mirror ball before a background, linear RGB [3, height, width], four samples a pixel."""
    places = positions_in_disc(ball, height, width)
    behind = np.kron(np.broadcast_to(background, (height, width)), np.ones((2, 2)))
    values = np.where(np.hypot(*places) < 1, light(disc_to_directions(places, ball.half_angle_rad)), behind)
    return values.reshape(3, height, 2, width, 2).mean((2, 4))


def background_of_boxes(height: int, width: int, seed: int) -> Floats:
    """Return a background of random boxes [height, width], brighter or darker than balls are at their contour."""
    rng = np.random.default_rng(seed)
    result = np.full((height, width), 0.8)
    for _ in range(40):
        y, x = rng.integers(height), rng.integers(width)
        box_height, box_width = rng.integers(10, 80, 2)
        result[y : y + box_height, x : x + box_width] = rng.choice([0.02, 0.04, 0.6, 0.7, 0.9, 1.0])
    return result


def pixels_of_linear(linear: Floats) -> Pixels:
    """Return linear RGB [3, height, width] in [0, 1] as the pixels of a photograph in memory."""
    return Pixels(linear.transpose(1, 2, 0).astype(np.float32), LINEAR_SPACE, False)


def write_linear_png(path: Path, linear: np.ndarray) -> Path:
    """Write linear RGB [3, height, width] in [0, 1] as a PNG of sRGB and return its path."""
    display = linear_to_srgb(torch.from_numpy(linear).clamp(0, 1)).permute(1, 2, 0).float()
    write_png(display, {"encoding": "sRGB"}, path)
    return path
