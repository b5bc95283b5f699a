"""HDR maps and photographs of balls, as tasks of illumination."""

from __future__ import annotations

from pathlib import Path

from data_tools.readers import latlong
from metapp.learning.task import Task

find, recognises, conversion = latlong.find, latlong.recognises, latlong.conversion  # the names that every reader has


def read_task(path: Path, size: int = latlong.HEIGHT, fov_rad: float = 0.0) -> Task:
    """Turn an HDR map, or an LDR photograph of a ball, into a task named by the file's stem.

    The ball is found in the photograph, unless one that touches the borders of the central square explains it as well,
    or none is found: then that square is taken.

    Args:
        path: the file.
        size: rows of a map.
        fov_rad: of the camera along the shorter side; 0: as EXIF says of uncropped photographs, else far away.

    Returns:
        As `latlong.read_task`; of a ball that is surely a mirror also `seen` and `certain`, as of
        `data_tools.balls.unwrap.unwrapped`, 1 where the photograph is white.

    Raises:
        ValueError: as `latlong.read_task`.
    """
    task = latlong.read_task(path, size)
    if "map" in task.data:
        return task
    from data_tools.balls.photo import read_photo  # here: it imports scipy, which maps do not need

    return read_photo(path, task, size, fov_rad)
