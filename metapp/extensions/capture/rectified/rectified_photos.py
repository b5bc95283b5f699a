"""Photographs rectified to the opening of a marker sheet, or to a square of a material without one.

They are written to a folder that the format `placed` reads.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch
from numpy.typing import NDArray

from data_tools.readers.image_files import Pixels, read_pixels
from data_tools.readers.square_photos import CAMERA_TEXT, LIGHT_TEXT, SIZE_TEXT
from metapp.appearance.colour import linear_to_srgb
from metapp.extensions.capture.hand_photos import import_opencv, write_outlines
from metapp.extensions.capture.rectified.features import apply_homography
from metapp.extensions.capture.rectified.found_outlines import KeepOutlines, ignore_outlines
from metapp.extensions.capture.rectified.plane import cameras_on_plane, cameras_on_square
from metapp.extensions.capture.rectified.registration import (
    WHOLE_PHOTO_CORNERS,
    Registration,
    change_reference,
    is_in_middle,
    refit_sightings,
    register_photos,
)
from metapp.extensions.capture.rectified.sheet import RULER_CM, Floats
from metapp.extensions.capture.rectified.sighting import (
    MAX_MARKER_ERROR_SIDES,
    Camera,
    NoMarkersError,
    Sighting,
    cameras_on_sheet,
    common_focal_length_mm,
    find_sheet,
)
from metapp.storage.files import write_atomically
from metapp.storage.folders import FOUND_FOLDER
from metapp.storage.image_writers import write_png

MIN_TILT_GAIN_DEGREES = 1.0  # by which a photo must be straighter than the reference to become the reference itself
MAX_SHOWN_VIEW_SIDES = 10  # how far outside a photo, in its sides, the view of another one is still drawn


@dataclass(frozen=True)
class CameraSearch:
    """A search for the cameras of photographs: what is known of them, and what is called while it goes on.

    Attributes:
        paths: the photographs, of one marker sheet or of one material.
        fov_rad: the field of view of the camera along the photographs' shorter side; 0 if it is not known: EXIF gives
            it, else the value that fits best is taken.
        ruler_cm: the measured length of the ruler on the printed sheet.
        report_photo: called with the name of each photograph that was searched for the sheet.
        report_stage: called with what is done next, in words, once all photographs have been searched for the sheet.
        keep_outlines: called with what is found in photographs, for a picture of photographs that do not serve.
    """

    paths: Sequence[Path]
    fov_rad: float = 0.0
    ruler_cm: float = RULER_CM
    report_photo: Callable[[str], object] = str
    report_stage: Callable[[str], object] = str
    keep_outlines: KeepOutlines = ignore_outlines


def find_cameras(
    search: CameraSearch, parts: Mapping[Path, Floats] = MappingProxyType({})
) -> tuple[list[Camera], float, list[str]]:
    """Find the sheet and the camera in photographs; without any marker, register the material's own features.

    Args:
        search: the photographs, what is known of them, and what is called on the way.
        parts: the parts of photographs that :func:`register_photos` takes.

    Returns:
        The cameras, the one from nearest to straight above first; the focal length in mm, as on 35 mm film, that was
        found for photographs without EXIF, else 0; a line for each photograph that is left out.

    Raises:
        ValueError: fewer than two photographs can be used, they show sheets of several sizes, no focal length is known
            and none can be found, or OpenCV is not installed.
    """
    sightings, unmarked, skipped = _find_sheets(search)
    if not sightings and len(unmarked) > 1:
        registration = register_photos(list(unmarked), search.fov_rad, parts, search.report_stage, search.keep_outlines)
        kept_lines = [line for line in skipped if line not in unmarked.values()]
        cameras, found_mm, misfits = _fit_registered(registration, search)
        straightest = min(cameras, key=lambda camera: camera.tilt_degrees)
        if straightest.tilt_degrees < cameras[0].tilt_degrees - MIN_TILT_GAIN_DEGREES:
            registration = change_reference(registration, straightest.sighting.path, search.report_stage)
            sightings_with_focal = [
                sighting._replace(focal_mm=sighting.focal_mm or found_mm) for sighting in registration.sightings()
            ]
            cameras, _, misfits = fit_cameras(sightings_with_focal, search)
        skipped = [*kept_lines, *registration.unmatched_lines(), *misfits]
    else:
        cameras, found_mm, misfits = fit_cameras(sightings, search)
        skipped += misfits
    if len(cameras) < 2:
        reason = f" ({skipped[0].partition(', expected')[0]})" if skipped else ""
        raise ValueError(
            f"{len(cameras)} of {len(search.paths)} photo{'s' * (len(search.paths) != 1)} can be used{reason}, "
            "expected two or more of one material; take more from other places, with the whole sheet in view."
        )
    return sorted(cameras, key=lambda camera: camera.view_angle_degrees), found_mm, skipped


def _fit_registered(registration: Registration, search: CameraSearch) -> tuple[list[Camera], float, list[str]]:
    """Find the cameras of registered photographs, see :func:`fit_cameras`.

    Where some do not fit, and more do by the matches in the middle of the reference alone, these count: around a
    sample, matches may lie on a table.
    """
    sightings = registration.sightings()
    found = fit_cameras(sightings, search)
    if not found[-1]:
        return found
    middle = refit_sightings(sightings, functools.partial(is_in_middle, sightings[0]))
    try:
        found_in_middle = fit_cameras(middle, search)
    except ValueError:  # photographs share no square, or do not tell the focal length
        return found
    return found_in_middle if len(found_in_middle[0]) > len(found[0]) else found


def fit_cameras(sightings: Sequence[Sighting], search: CameraSearch) -> tuple[list[Camera], float, list[str]]:
    """Find the cameras of photographs, in their order, and leave out photographs that do not fit.

    Returns:
        The cameras; the focal length in mm, as on 35 mm film, that was found for photographs without EXIF, else 0; a
        line for each photograph that is left out.
    """
    skipped: list[str] = []
    for sighting in [] if not sightings or sightings[0].shows_sheet else sightings:
        search.keep_outlines(sighting.path, f"{len(sighting.markers)} points shared", sighting.markers, "lime")
    search.report_stage("positions of the cameras")
    while True:  # without the worst photo, plane and square are found again by the others
        is_plane = len(sightings) > 1 and not sightings[0].shows_sheet
        cameras_of, without_focal = (
            cameras_on_plane if is_plane else cameras_on_sheet,
            [sighting for sighting in sightings if not sighting.focal_mm],
        )
        found_mm = (
            common_focal_length_mm(sightings if is_plane else without_focal, cameras_of) if without_focal else 0.0
        )
        cameras = cameras_of(sightings, found_mm)
        if is_plane:
            show_views(cameras, search.keep_outlines)
            cameras = cameras_on_square(cameras)
        worst = max(filter(_describe_misfit, cameras), key=lambda camera: camera.error_px, default=None)
        if worst is None:
            return cameras, found_mm, skipped
        skipped.append(_describe_misfit(worst))
        sightings = [sighting for sighting in sightings if sighting.path != worst.sighting.path]


def show_views(cameras: Sequence[Camera], keep_outlines: KeepOutlines) -> None:
    """Show in the first photograph, the reference, which part of the plane each of the others sees."""
    first, outlines = cameras[0].sighting, []
    for sighting, *_ in cameras[1:]:
        to_first = first.to_px @ np.linalg.inv(sighting.to_px)
        outline = apply_homography(to_first, WHOLE_PHOTO_CORNERS * [sighting.width - 1, sighting.height - 1])
        if np.abs(outline).max() < MAX_SHOWN_VIEW_SIDES * (first.width + first.height):
            outlines.append(outline)
    keep_outlines(first.path, "views of the other photos", np.reshape(outlines, (-1, 4, 2)), "cyan")


def _find_sheets(search: CameraSearch) -> tuple[list[Sighting], dict[Path, str], list[str]]:
    """Find the sheet in photographs, which must show one sheet.

    Returns:
        The sightings; for each photograph without a marker its line; the lines of all photographs that show no whole
        sheet.
    """
    import_opencv()
    sightings: list[Sighting] = []
    unmarked, skipped = {}, []
    for path in search.paths:
        try:
            sightings.append(find_sheet(path, search.fov_rad, search.ruler_cm, search.keep_outlines))
        except (ValueError, OSError) as error:
            skipped.append(str(error))
            if isinstance(error, NoMarkersError):
                unmarked[path] = str(error)
        search.report_photo(path.name)
    for sighting in sightings[1:]:
        if sighting.opening_cm != sightings[0].opening_cm:
            raise ValueError(
                f"{sighting.path}: a sheet with an opening of {sighting.opening_cm:g} cm, expected "
                f"{sightings[0].opening_cm:g} cm as in {sightings[0].path.name}; give photos of one material in one "
                "sheet."
            )
    return sightings, unmarked, skipped


def _describe_misfit(camera: Camera) -> str:
    """Return the line that points do not lie where a camera sees them; "" if they do."""
    path, sighting = camera.sighting.path, camera.sighting
    limit_px = MAX_MARKER_ERROR_SIDES * sighting.opening_cm * sighting.px_per_cm()[1]
    if camera.error_px <= limit_px:
        return ""
    error_text = f"{camera.error_px:.1f} px from where a lens of {sighting.focal_mm:.0f} mm sees them"
    remedy = "give the photo uncropped, or the camera's --fov"
    return f"{path}: points are {error_text}, expected up to {limit_px:.1f}; {remedy}."


def write_rectified_photos(
    cameras: Sequence[Camera],
    lights_cm: Sequence[Floats],
    size: int,
    folder: Path,
    report_picture: Callable[[str], object] = str,
) -> None:
    """Write pictures 00.png, ..., pictures of the markers in each photograph, and texts of the places.

    Args:
        cameras: the cameras of the photographs.
        lights_cm: the places of the flashes, [3] each.
        size: the side of the pictures, in px.
        folder: the folder, made if missing; the texts, by which readers recognise it, are written last.
        report_picture: called with the name of each picture that was written.

    Raises:
        OSError: a file cannot be written.
    """
    for number, (sighting, *_) in enumerate(cameras):
        pixels, name = read_pixels(sighting.path), f"{number:02}.png"
        bits = 8 if pixels.values.dtype == np.uint8 else 16
        picture = torch.from_numpy(rectify_opening(pixels, sighting, size))
        write_png(picture, {"encoding": "sRGB"}, folder / name, bits)
        outlines = [*((marker, "lime") for marker in sighting.markers), (sighting.corners_px(), "magenta")]
        write_outlines(pixels, [(points + 0.5, colour) for points, colour in outlines], folder / FOUND_FOLDER / name)
        report_picture(name)
    sizes, places = np.array([cameras[0].sighting.opening_cm]), np.stack([camera.place_cm for camera in cameras])
    for name, rows in ((SIZE_TEXT, sizes), (LIGHT_TEXT, np.stack(lights_cm)), (CAMERA_TEXT, places)):
        write_atomically(folder / name, functools.partial(np.savetxt, X=rows, fmt="%.4f", delimiter=","))


def rectify_opening(pixels: Pixels, sighting: Sighting, size: int) -> NDArray[np.float32]:
    """Return the opening as a square, with the sheet's upper edge on top.

    Means are taken in linear light over as many samples as the photograph has there.

    Args:
        pixels: the photograph.
        sighting: the sheet, or the square, in the photograph.
        size: the side of the square, in px.

    Returns:
        sRGB values, [size, size, 3] in [0, 1].
    """
    cv2, side_cm = import_opencv(), sighting.opening_cm
    corners = sighting.corners_px()
    left, top = np.maximum(np.floor(corners.min(0)).astype(int) - 1, 0)
    right, bottom = np.ceil(corners.max(0)).astype(int) + 2
    cutout = pixels._replace(values=pixels.values[top:bottom, left:right, :3])
    linear = np.ascontiguousarray(cutout.linear())
    side = size * max(2, math.ceil(sighting.px_per_cm()[1] * side_cm / size))
    step_cm, middle_px = side_cm / side, (side - 1) / 2
    to_cm = np.array([[step_cm, 0, -middle_px * step_cm], [0, -step_cm, middle_px * step_cm], [0, 0, 1]])
    to_cutout = np.array([[1, 0, -left], [0, 1, -top], [0, 0, 1]]) @ sighting.to_px @ to_cm
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    samples = cv2.warpPerspective(linear, to_cutout, (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    means = cv2.resize(samples, (size, size), interpolation=cv2.INTER_AREA)
    return linear_to_srgb(torch.from_numpy(means)).numpy()
