"""Photographs of the marker sheet, rectified to the opening.

They are written to a folder that the format `placed` reads.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from data_tools.readers.flash_places import CAMERA, LIGHT, SIZE
from data_tools.readers.image_files import Pixels, read_pixels
from data_tools.readers.photos import FRAME_MM, linear_light
from metapp.appearance.colour import linear_to_srgb
from metapp.extensions.capture.markers.sheet import RULER_CM, Floats
from metapp.extensions.capture.markers.sighting import Camera, Sighting, common_focal, find_sheet, fitting_camera
from metapp.extensions.capture.photos import FOUND, opencv, write_found
from metapp.storage.files import write_atomically
from metapp.storage.images import write_png

LARGEST_PX = 1024


class PhotoSet(NamedTuple):
    """Photographs to write, the one from nearest to straight above first.

    Attributes:
        cameras: of each.
        flash_cm: where the flash is beside the lens: right and up in the photograph.
        size: side of the pictures in px: no more than the first photograph resolves, which shows most detail.
        focal_mm: as of 35 mm film, where it was found by how photographs without EXIF fit best; else 0.
        skipped: a line for each photograph that is left out.
    """

    cameras: Sequence[Camera]
    flash_cm: Sequence[float]
    size: int
    focal_mm: float
    skipped: Sequence[str]

    @property
    def side_cm(self) -> float:
        """Side of the opening."""
        return self.cameras[0].sighting.opening_cm

    def lights_cm(self) -> list[Floats]:
        """Places of the flash, [3] each."""
        right, up = self.flash_cm
        return [camera.place_cm + right * camera.axes[0] - up * camera.axes[1] for camera in self.cameras]


def find_cameras(
    paths: Sequence[Path],
    size: int = LARGEST_PX,
    fov_rad: float = 0.0,
    flash_cm: Sequence[float] = (0.0, 0.0),
    ruler_cm: float = RULER_CM,
    done: Callable[[str], object] = str,
) -> PhotoSet:
    """Find sheet and camera in photographs.

    Args:
        paths: the photographs, of one sheet.
        size: greatest side of the pictures in px.
        fov_rad: of the camera along the photographs' shorter side; 0: as EXIF says, else as fits best.
        flash_cm: where the flash is beside the lens: right and up in the photograph.
        ruler_cm: measured length of the printed ruler.
        done: called with the name of each photograph that was searched.

    Raises:
        ValueError: fewer than two can be used; they show sheets of several sizes; no focal length is known, and none
            can be found; OpenCV is not installed.
    """
    opencv()
    sightings: list[Sighting] = []
    cameras, skipped = [], []
    for path in paths:
        try:
            sighting = find_sheet(path, ruler_cm)
        except (ValueError, OSError) as error:
            skipped.append(str(error))
        else:
            if fov_rad:  # the inverse of `data_tools.readers.photos.field_of_view`
                share = min(sighting.height, sighting.width) / math.hypot(sighting.height, sighting.width)
                sighting = sighting._replace(focal_mm=FRAME_MM * share / 2 / math.tan(fov_rad / 2))
            sightings.append(sighting)
        done(path.name)
    for sighting in sightings[1:]:
        if sighting.opening_cm != sightings[0].opening_cm:
            raise ValueError(
                f"{sighting.path}: a sheet with an opening of {sighting.opening_cm:g} cm, expected "
                f"{sightings[0].opening_cm:g} cm as in {sightings[0].path.name}; give photos of one material in one "
                "sheet."
            )
    without = [sighting for sighting in sightings if not sighting.focal_mm]
    found_mm = common_focal(without) if without else 0.0
    for sighting in sightings:
        try:
            cameras.append(fitting_camera(sighting, sighting.focal_mm or found_mm))
        except ValueError as error:
            skipped.append(str(error))
    if len(cameras) < 2:
        why = f" ({skipped[0].partition(', expected')[0]})" if skipped else ""
        raise ValueError(
            f"{len(cameras)} of {len(paths)} photo{'s' * (len(paths) != 1)} can be used{why}, expected two or more of "
            "one material; take more from other places, with the whole sheet in view."
        )
    cameras.sort(key=lambda camera: camera.tilt_degrees)
    first = cameras[0].sighting
    return PhotoSet(cameras, flash_cm, min(size, int(first.opening_cm * first.scales()[0])), found_mm, skipped)


def write_set(photos: PhotoSet, folder: Path, done: Callable[[str], object] = str) -> None:
    """Write pictures 00.png, ..., what was found in each, and the texts.

    Args:
        photos: the photographs.
        folder: made if missing; the texts, by which readers know it, are written last.
        done: called with the name of each picture that was written.

    Raises:
        OSError: a file cannot be written.
    """
    for number, camera in enumerate(photos.cameras):
        sighting, name = camera.sighting, f"{number:02}.png"
        pixels = read_pixels(sighting.path)
        bits = 8 if pixels.values.dtype == np.uint8 else 16
        picture = torch.from_numpy(rectified(pixels, sighting, photos.size))
        write_png(picture, {"encoding": "sRGB"}, folder / name, bits)
        outlines = [*((marker, "lime") for marker in sighting.markers), (sighting.corners_px(), "magenta")]
        write_found(pixels, [(points + 0.5, colour) for points, colour in outlines], folder / FOUND / name)
        done(name)
    places = [camera.place_cm for camera in photos.cameras]
    for name, rows in ((SIZE, [[photos.side_cm]]), (LIGHT, photos.lights_cm()), (CAMERA, places)):
        write_atomically(folder / name, functools.partial(np.savetxt, X=rows, fmt="%.4f", delimiter=","))


def rectified(pixels: Pixels, sighting: Sighting, size: int) -> NDArray[np.float32]:
    """The opening as a square, sRGB [size, size, 3] in [0, 1], the sheet's upper edge on top.

    Means are taken in linear light over as many samples as the photograph has there.
    """
    cv2, side_cm = opencv(), sighting.opening_cm
    corners = sighting.corners_px()
    left, top = np.maximum(np.floor(corners.min(0)).astype(int) - 1, 0)
    right, bottom = np.ceil(corners.max(0)).astype(int) + 2
    part = pixels._replace(values=pixels.values[top:bottom, left:right, :3])
    linear = np.ascontiguousarray(linear_light(part, slice(None)))
    side = size * max(2, math.ceil(sighting.scales()[1] * side_cm / size))
    step, middle = side_cm / side, (side - 1) / 2  # cm, px
    to_cm = np.array([[step, 0, -middle * step], [0, -step, middle * step], [0, 0, 1]])
    to_part = np.array([[1, 0, -left], [0, 1, -top], [0, 0, 1]]) @ sighting.to_px @ to_cm
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    samples = cv2.warpPerspective(linear, to_part, (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    result = cv2.resize(samples, (size, size), interpolation=cv2.INTER_AREA)
    return linear_to_srgb(torch.from_numpy(result)).numpy()
