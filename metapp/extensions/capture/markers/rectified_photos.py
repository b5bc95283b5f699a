"""Photographs of the marker sheet, or of a material without one, rectified to the opening, or a square.

They are written to a folder that the format `placed` reads.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch
from numpy.typing import NDArray

from data_tools.readers.image_files import Pixels, read_pixels
from data_tools.readers.square_photos import SIZE_TEXT
from metapp.appearance.colour import linear_to_srgb
from metapp.extensions.capture.hand_photos import import_opencv, write_outlines
from metapp.extensions.capture.markers.found_outlines import KeepOutlines, ignore_outlines
from metapp.extensions.capture.markers.plane import cameras_on_plane, cameras_on_square
from metapp.extensions.capture.markers.registration import (
    WHOLE_PHOTO_CORNERS,
    apply_homography,
    change_reference,
    register_photos,
)
from metapp.extensions.capture.markers.sheet import RULER_CM, Floats
from metapp.extensions.capture.markers.sighting import (
    MAX_MARKER_ERROR_SIDES,
    Camera,
    NoMarkersError,
    Sighting,
    cameras_on_sheet,
    common_focal_length_mm,
    find_sheet,
)
from metapp.storage.files import write_atomically
from metapp.storage.folders import CAMERA_TEXT, DIAGNOSTIC_FOLDER, LIGHT_TEXT
from metapp.storage.image_writers import write_png

MIN_TILT_GAIN_DEGREES = 1.0  # by which a photo's tilt is less than the reference's that it takes the place of
MAX_SHOWN_VIEW_SIDES = 10  # width and height of a photo, how far outside it a view of another one is still drawn


def find_cameras(
    paths: Sequence[Path],
    fov_rad: float = 0.0,
    ruler_cm: float = RULER_CM,
    done: Callable[[str], object] = str,
    begin: Callable[[str], object] = str,
    show: KeepOutlines = ignore_outlines,
    parts: Mapping[Path, Floats] = MappingProxyType({}),
) -> tuple[list[Camera], float, list[str]]:
    """Find sheet and camera in photographs; without any marker, the material's own features.

    Args:
        paths: the photographs, of one sheet or of one material.
        fov_rad: of the camera along the photographs' shorter side; 0: as EXIF says, else as fits best.
        ruler_cm: measured length of the printed ruler.
        done: called with the name of each photograph that was searched.
        begin: called with what is done next, in words, once all photographs have been searched.
        show: called with what is found in photographs, for a picture of what does not serve.
        parts: as :func:`register_photos` takes it.

    Returns:
        Cameras, the one from nearest to straight above first; the focal length in mm as of 35 mm film, if photographs
        without EXIF tell it, else 0; a line for each photograph that is left out.

    Raises:
        ValueError: fewer than two can be used; they show sheets of several sizes; no focal length is known, and none
            can be found; OpenCV is not installed.
    """
    sightings, plain, skipped = _sheets(paths, fov_rad, ruler_cm, done, show)
    if not sightings and len(plain) > 1:
        registration = register_photos(list(plain), fov_rad, parts, begin, show)
        kept = [line for line in skipped if line not in plain.values()]
        cameras, found_mm, odd = _cameras(registration.sightings(), begin, show)
        straightest = min(cameras, key=lambda camera: camera.tilt_degrees)
        if straightest.tilt_degrees < cameras[0].tilt_degrees - MIN_TILT_GAIN_DEGREES:
            registration = change_reference(registration, straightest.sighting.path, begin)
            known = [each._replace(focal_mm=each.focal_mm or found_mm) for each in registration.sightings()]
            cameras, _, odd = _cameras(known, begin, show)
        skipped = [*kept, *registration.lost(), *odd]
    else:
        cameras, found_mm, odd = _cameras(sightings, begin, show)
        skipped += odd
    if len(cameras) < 2:
        why = f" ({skipped[0].partition(', expected')[0]})" if skipped else ""
        raise ValueError(
            f"{len(cameras)} of {len(paths)} photo{'s' * (len(paths) != 1)} can be used{why}, expected two or more of "
            "one material; take more from other places, with the whole sheet in view."
        )
    return sorted(cameras, key=lambda camera: camera.aside_degrees), found_mm, skipped


def _cameras(
    sightings: Sequence[Sighting], begin: Callable[[str], object], show: KeepOutlines
) -> tuple[list[Camera], float, list[str]]:
    """Find the cameras of photographs, in their order, and leave out those that do not fit.

    Returns:
        Cameras; the focal length in mm as of 35 mm film, if photographs without EXIF tell it, else 0; a line for each
        photograph that is left out.
    """
    skipped: list[str] = []
    for sighting in [] if not sightings or sightings[0].sheet else sightings:
        show(sighting.path, f"{len(sighting.markers)} points shared", sighting.markers, "lime")
    begin("positions of the cameras")
    while True:  # without the oddest photo the plane and the square are those of the others
        plane = len(sightings) > 1 and not sightings[0].sheet
        cameras_of, unknown = cameras_on_plane if plane else cameras_on_sheet, [x for x in sightings if not x.focal_mm]
        found_mm = common_focal_length_mm(sightings if plane else unknown, cameras_of) if unknown else 0.0
        cameras = cameras_of(sightings, found_mm)
        if plane:
            show_views(cameras, show)
            cameras = cameras_on_square(cameras)
        odd = max(filter(_fault_of, cameras), key=lambda camera: camera.error_px, default=None)
        if odd is None:
            return cameras, found_mm, skipped
        skipped.append(_fault_of(odd))
        sightings = [each for each in sightings if each.path != odd.sighting.path]


def show_views(cameras: Sequence[Camera], show: KeepOutlines) -> None:
    """Show in the first photograph, the reference, which part of the plane each of the others sees."""
    first, outlines = cameras[0].sighting, []
    for sighting, *_ in cameras[1:]:
        to_first = first.to_px @ np.linalg.inv(sighting.to_px)
        outline = apply_homography(to_first, WHOLE_PHOTO_CORNERS * [sighting.width - 1, sighting.height - 1])
        if np.abs(outline).max() < MAX_SHOWN_VIEW_SIDES * (first.width + first.height):
            outlines.append(outline)
    show(first.path, "views of the other photos", np.reshape(outlines, (-1, 4, 2)), "cyan")


def _sheets(
    paths: Sequence[Path], fov_rad: float, ruler_cm: float, done: Callable[[str], object], show: KeepOutlines
) -> tuple[list[Sighting], dict[Path, str], list[str]]:
    """Sightings of one sheet; the lines of photographs without a marker; those of all that show no whole sheet."""
    import_opencv()
    sightings: list[Sighting] = []
    plain, skipped = {}, []
    for path in paths:
        try:
            sightings.append(find_sheet(path, fov_rad, ruler_cm, show))
        except (ValueError, OSError) as error:
            skipped.append(str(error))
            if isinstance(error, NoMarkersError):
                plain[path] = str(error)
        done(path.name)
    for sighting in sightings[1:]:
        if sighting.opening_cm != sightings[0].opening_cm:
            raise ValueError(
                f"{sighting.path}: a sheet with an opening of {sighting.opening_cm:g} cm, expected "
                f"{sightings[0].opening_cm:g} cm as in {sightings[0].path.name}; give photos of one material in one "
                "sheet."
            )
    return sightings, plain, skipped


def _fault_of(camera: Camera) -> str:
    """The line why points do not lie where a camera sees them; "" if they do."""
    path, limit_px = (
        camera.sighting.path,
        MAX_MARKER_ERROR_SIDES * camera.sighting.opening_cm * camera.sighting.scales()[1],
    )
    if camera.error_px <= limit_px:
        return ""
    seen = f"{camera.error_px:.1f} px from where a lens of {camera.sighting.focal_mm:.0f} mm sees them"
    return f"{path}: points are {seen}, expected up to {limit_px:.1f}; give the photo uncropped, or the camera's --fov."


def write_rectified_photos(
    cameras: Sequence[Camera],
    lights_cm: Sequence[Floats],
    size: int,
    folder: Path,
    done: Callable[[str], object] = str,
) -> None:
    """Write pictures 00.png, ..., pictures of the markers in each, and the texts.

    Args:
        cameras: of the photographs.
        lights_cm: places of the flash, [3] each.
        size: side of the pictures in px.
        folder: made if missing; the texts, by which readers know it, are written last.
        done: called with the name of each picture that was written.

    Raises:
        OSError: a file cannot be written.
    """
    for number, (sighting, *_) in enumerate(cameras):
        pixels, name = read_pixels(sighting.path), f"{number:02}.png"
        bits = 8 if pixels.values.dtype == np.uint8 else 16
        picture = torch.from_numpy(rectify_opening(pixels, sighting, size))
        write_png(picture, {"encoding": "sRGB"}, folder / name, bits)
        outlines = [*((marker, "lime") for marker in sighting.markers), (sighting.corners_px(), "magenta")]
        write_outlines(
            pixels, [(points + 0.5, colour) for points, colour in outlines], folder / DIAGNOSTIC_FOLDER / name
        )
        done(name)
    sizes, places = np.array([cameras[0].sighting.opening_cm]), np.stack([camera.place_cm for camera in cameras])
    for name, rows in ((SIZE_TEXT, sizes), (LIGHT_TEXT, np.stack(lights_cm)), (CAMERA_TEXT, places)):
        write_atomically(folder / name, functools.partial(np.savetxt, X=rows, fmt="%.4f", delimiter=","))


def rectify_opening(pixels: Pixels, sighting: Sighting, size: int) -> NDArray[np.float32]:
    """The opening as a square, sRGB [size, size, 3] in [0, 1], the sheet's upper edge on top.

    Means are taken in linear light over as many samples as the photograph has there.
    """
    cv2, side_cm = import_opencv(), sighting.opening_cm
    corners = sighting.corners_px()
    left, top = np.maximum(np.floor(corners.min(0)).astype(int) - 1, 0)
    right, bottom = np.ceil(corners.max(0)).astype(int) + 2
    part = pixels._replace(values=pixels.values[top:bottom, left:right, :3])
    linear = np.ascontiguousarray(part.linear())
    side = size * max(2, math.ceil(sighting.scales()[1] * side_cm / size))
    step, middle = side_cm / side, (side - 1) / 2  # cm, px
    to_cm = np.array([[step, 0, -middle * step], [0, -step, middle * step], [0, 0, 1]])
    to_part = np.array([[1, 0, -left], [0, 1, -top], [0, 0, 1]]) @ sighting.to_px @ to_cm
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    samples = cv2.warpPerspective(linear, to_part, (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    result = cv2.resize(samples, (size, size), interpolation=cv2.INTER_AREA)
    return linear_to_srgb(torch.from_numpy(result)).numpy()
