"""LDR photographs of balls, as tasks of illumination."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from data_tools.readers import latlong
from data_tools.readers.image_files import Pixels, read_pixels
from data_tools.readers.listing import files_of
from data_tools.readers.photos import find_photos, is_photo, photo_of
from metapp.appearance.latlong import sphere_normals
from metapp.learning.task import Task

_SAME = 0.03  # of the radius, by which a ball may miss the one that touches the central square's borders
_BETTER = 1.2  # of its score, that another ball must have


def recognises(path: Path) -> bool:
    """True if a path is an LDR image, or a folder with one below it."""
    return any(is_photo(file) and not latlong.is_map(file) for file in files_of(path))


def find(paths: Iterable[Path]) -> tuple[list[Path], list[str]]:
    """All LDR images; as `data_tools.readers.photos.find_photos`."""
    files, skipped = find_photos(paths)
    return [file for file in files if not latlong.is_map(file)], skipped


def read_task(path: Path, rows: int = latlong.HEIGHT, fov_rad: float = 0.0) -> Task:
    """Turn an LDR photograph of a ball into a task named by the file's stem.

    The ball is found in the photograph, unless one that touches the borders of the central square explains it as well,
    or none is found: then that square is taken.

    Args:
        path: the file.
        rows: of a map.
        fov_rad: of the camera along the shorter side; 0: as EXIF says of uncropped photographs, else far away.

    Returns:
        `photos` uint8 [1, 3, 64, 64], black outside the ball; of one that is surely a mirror also `seen` and `certain`,
        as of `metapp.extensions.capture.ball.unwrap.unwrapped`, 1 where the photograph is white.

    Raises:
        ValueError: as `data_tools.readers.photos.read_photo`; a picture twice as wide as high; a disc that is black.
    """
    return _task(read_pixels(path), path.stem, str(path), rows, fov_rad)


def task_of_pixels(pixels: Pixels, name: str, rows: int = latlong.HEIGHT, fov_rad: float = 0.0) -> Task:
    """The same of a photograph in memory."""
    return _task(pixels, name, name, rows, fov_rad)


def _task(pixels: Pixels, name: str, subject: str, rows: int, fov_rad: float) -> Task:
    height, width = pixels.values.shape[:2]
    if latlong.is_latlong(height, width):
        raise ValueError(
            f"{subject}: {width}x{height} px of {pixels.values.dtype}, expected an HDR map (.exr or .hdr) or a "
            "photograph of a sphere; export the map as HDR, or crop the photograph to the sphere."
        )
    photo = photo_of(pixels, subject, latlong.SIZE) * sphere_normals(latlong.SIZE)[1]
    if not photo.any():
        reason = "black inside the disc, expected a sphere that touches the borders; crop it to that."
        raise ValueError(f"{subject}: {reason}")
    task = Task(name, {"photos": photo[None]})
    # what is transparent is no contour
    return _with_ball(pixels, task, rows, fov_rad) if pixels.values.shape[-1] == 3 else task


def _with_ball(pixels: Pixels, task: Task, rows: int, fov_rad: float) -> Task:
    """The task of the ball alone, and of what it mirrors; of the central square where its ball is as good."""
    # here: they import scipy, which `recognises` does not need
    from metapp.extensions.capture.ball.capture import light_around
    from metapp.extensions.capture.ball.circle import FOUND, best_ball, score_of
    from metapp.extensions.capture.ball.mirror import is_mirror
    from metapp.extensions.capture.ball.shots import gray_of, lens_of, photo_of, shot_of
    from metapp.extensions.capture.ball.view import Ball

    gray = gray_of(pixels)
    height, width = gray.shape
    central = Ball(width / 2, height / 2, min(height, width) / 2)
    ball = best_ball(gray, lens_of(pixels, fov_rad))
    is_other = ball is not None and ball.score >= max(FOUND, _BETTER * score_of(gray, central))
    if ball and max(np.abs(np.subtract(ball[:3], central[:3]))) < _SAME * central.radius:
        is_other = False
    shot = shot_of(pixels, ball if ball and is_other else central)
    if is_mirror(shot):
        return light_around([shot], 0, np.ones(1), rows).task(task.name)
    return Task(task.name, {"photos": photo_of(shot, shot.ball.angle)[None]}) if is_other else task
