"""LDR photographs of balls, as tasks of illumination."""

from __future__ import annotations

from pathlib import Path

from data_tools.readers import environment_maps, square_photos
from data_tools.readers.colours import integers_to_unit_range
from data_tools.readers.image_files import ALL_PICTURE_SUFFIXES, Pixels, read_pixels
from data_tools.readers.input_source import Sources, sources_of_files
from data_tools.readers.listing import files_of
from data_tools.readers.square_photos import is_photo, to_square_photo
from metapp.appearance.latlong import sphere_normals
from metapp.learning.task import Task


def recognises(path: Path) -> bool:
    """True if a path is an LDR image, or a folder with one below it."""
    return any(is_photo(file) and not environment_maps.is_map(file) for file in files_of(path, ALL_PICTURE_SUFFIXES))


def find(path: Path) -> Sources:
    """Find all LDR images, as `data_tools.readers.square_photos.find_images`."""
    files, skipped = square_photos.find_images(path)
    return sources_of_files(([file for file in files if not environment_maps.is_map(file)], skipped), protocol="photo")


def read_task(path: Path, rows: int = environment_maps.MAP_HEIGHT_PX, fov_rad: float = 0.0, layer: str = "") -> Task:
    """Turn an LDR photograph of a ball into a task named by the file's stem; as `task_of_pixels`."""
    return task_of_pixels(read_pixels(path, layer), str(path), rows, fov_rad)._replace(name=path.stem)


def task_of_pixels(pixels: Pixels, name: str, rows: int = environment_maps.MAP_HEIGHT_PX, fov_rad: float = 0.0) -> Task:
    """Turn a photograph of a ball into a task.

    The ball is found in the photograph, unless one that touches the borders of the central square explains it as well,
    or none is found: then that square is taken.

    Args:
        pixels: the photograph.
        name: of the task; begins errors.
        rows: of a map.
        fov_rad: of the camera along the shorter side; 0: as EXIF says of uncropped photographs, else far away.

    Returns:
        `photos` uint8 [1, 3, 64, 64], black outside the ball; of one that is surely a mirror also `seen` and `certain`,
        as of `metapp.extensions.capture.ball.capture.unwrap_ball`, 1 if the photograph is white.

    Raises:
        ValueError: as `data_tools.readers.square_photos.to_square_photo`; a picture twice as wide as high; a disc that is black.
    """
    height, width, channels = pixels.values.shape
    if environment_maps.is_latlong(height, width):
        raise ValueError(
            f"{name}: {width}x{height} px of {pixels.values.dtype}, expected an HDR map (.exr or .hdr) or a "
            "photograph of a sphere; export the map as HDR, or crop the photograph to the sphere."
        )
    square = (
        to_square_photo(pixels, name, environment_maps.SPHERE_PHOTO_PX)[None]
        * sphere_normals(environment_maps.SPHERE_PHOTO_PX)[1]
    )
    if not square.any():
        raise ValueError(f"{name}: black inside the disc, expected a sphere that touches the borders; crop it to that.")
    if channels == 4 and integers_to_unit_range(pixels.values[..., 3]).min() < 1:  # what is transparent is no contour
        return Task(name, {"photos": square})
    from metapp.extensions.capture.ball.capture import (
        capture_single_photo,  # here: it takes 0.7 s, and maps need it not
    )

    return Task(name, capture_single_photo(pixels, name, square, rows, fov_rad))
