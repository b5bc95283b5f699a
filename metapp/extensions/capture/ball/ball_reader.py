"""The format of LDR photographs of balls, which are inputs of illumination.

It has the functions that :class:`metapp.registry.Format` lists. A ball is found and unwrapped by
:mod:`metapp.extensions.capture.ball.capture`.
"""

from __future__ import annotations

from pathlib import Path

from data_tools.readers import environment_maps, square_photos
from data_tools.readers.colours import integers_to_unit_range
from data_tools.readers.image_files import Pixels, read_pixels
from data_tools.readers.input_source import REFERENCE_FACT, Sources, sources_of_files
from data_tools.readers.listing import files_of
from data_tools.readers.opened_images import ALL_PICTURE_SUFFIXES
from data_tools.readers.picture_borders import crop_borders
from data_tools.readers.square_photos import is_photo, to_square_photo
from metapp.appearance.latlong import sphere_normals
from metapp.learning.task import Task


def recognises(path: Path) -> bool:
    """Return True if a path is an LDR image, or a folder with one below it."""
    return any(is_photo(file) and not environment_maps.is_map(file) for file in files_of(path, ALL_PICTURE_SUFFIXES))


def find(path: Path) -> Sources:
    """Find all LDR images below a path as :func:`data_tools.readers.square_photos.find_images` does, without maps."""
    files, skipped = square_photos.find_images(path)
    photos = [file for file in files if not environment_maps.is_map(file)]
    return sources_of_files((photos, skipped), {REFERENCE_FACT: False})


def read_task(path: Path, rows: int = environment_maps.MAP_HEIGHT_PX, fov_rad: float = 0.0, layer: str = "") -> Task:
    """Read an LDR photograph of a ball as a task named by the file's stem; see :func:`task_of_pixels`."""
    return task_of_pixels(read_pixels(path, layer), str(path), rows, fov_rad)._replace(name=path.stem)


def task_of_pixels(pixels: Pixels, name: str, rows: int = environment_maps.MAP_HEIGHT_PX, fov_rad: float = 0.0) -> Task:
    """Turn a photograph of a ball into a task.

    The ball is found in the photograph. The central square is taken instead where no ball is found, or where a ball
    that touches the square's borders explains the photograph as well.

    Args:
        pixels: the photograph.
        name: the name of the task, with which messages begin.
        rows: the number of rows of the map.
        fov_rad: the field of view of the camera along the shorter side; 0 if it is not known: EXIF of uncropped
            photographs gives it, else the camera is taken to be far away.

    Returns:
        A task with `photos`, uint8 [1, 3, 64, 64], black outside the ball. If the ball is surely a mirror, also `seen`
        and `certain` of :func:`metapp.extensions.capture.ball.capture.unwrap_ball`, with radiance 1 where the
        photograph is white.

    Raises:
        ValueError: :func:`data_tools.readers.square_photos.to_square_photo` refuses the photograph, it is twice as wide
            as high or states that it is a panorama, or the disc is black.
    """
    height, width, channels = pixels.values.shape
    if environment_maps.is_latlong(height, width) or pixels.is_panorama:
        raise ValueError(
            f"{name}: {width}x{height} px of {pixels.values.dtype}, expected an HDR map (.exr or .hdr) or a "
            "photograph of a sphere; export the map as HDR, or crop the photograph to the sphere."
        )
    pixels = crop_borders(pixels, name, is_cut_out=True)
    square = (
        to_square_photo(pixels, name, environment_maps.SPHERE_PHOTO_PX)[None]
        * sphere_normals(environment_maps.SPHERE_PHOTO_PX)[1]
    )
    if not square.any():
        raise ValueError(f"{name}: black inside the disc, expected a sphere that touches the borders; crop it to that.")
    if (
        channels == 4 and integers_to_unit_range(pixels.values[..., 3]).min() < 1
    ):  # the border of transparency is no contour of a ball
        return Task(name, {"photos": square})
    # imported here: it takes 0.7 s, which maps need not pay
    from metapp.extensions.capture.ball.capture import capture_single_photo

    return Task(name, capture_single_photo(pixels, name, square, rows, fov_rad))
