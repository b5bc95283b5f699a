"""Photographs of the marker sheet, rectified to the opening.

They are written to a folder that the format `placed` reads.
"""

from __future__ import annotations

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
from metapp.extensions.capture.markers.sighting import LIMIT, Pose, Sighting, common_focal, find_sheet, pose_of
from metapp.extensions.capture.opencv import opencv
from metapp.storage.files import write_atomically
from metapp.storage.images import write_png

LARGEST_PX = 1024
FOUND = "found"  # folder of pictures that show what was found

_SHOWN_PX = 1200  # the longer side of pictures that show what was found


class Placed(NamedTuple):
    """A photograph that can be rectified.

    Attributes:
        sighting: the sheet in it.
        pose: of its camera, as if the sheet was printed true to scale.
        camera_cm, light_cm: where camera and flash were, to the sheet's true scale.
    """

    sighting: Sighting
    pose: Pose
    camera_cm: Floats
    light_cm: Floats


class Set(NamedTuple):
    """Photographs to write, that from nearest to straight above first.

    Attributes:
        photos: what is written.
        skipped: a line for each other one.
        side_cm: of the opening, to the sheet's true scale.
        size: side of the pictures in px: no more than the first photograph resolves, which shows most detail.
        focal_mm: as of 35 mm film, where it was found by how photographs without EXIF fit best; else 0.
    """

    photos: list[Placed]
    skipped: list[str]
    side_cm: float
    size: int
    focal_mm: float


def place(
    paths: Sequence[Path],
    *,
    size: int = LARGEST_PX,
    fov_rad: float = 0.0,
    flash_cm: tuple[float, float] = (0.0, 0.0),
    ruler_cm: float = RULER_CM,
    done: Callable[[str], object] = str,
) -> Set:
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
    sightings, skipped = [], []
    for path in paths:
        try:
            sightings.append(find_sheet(path))
        except (ValueError, OSError) as error:
            skipped.append(str(error))
        done(path.name)
    _check_one_sheet(sightings)
    if fov_rad:
        sightings = [each._replace(focal_mm=_focal_of(fov_rad, each.height, each.width)) for each in sightings]
    without = [each for each in sightings if not each.focal_mm]
    found_mm = common_focal(without) if without else 0.0
    photos = []
    for sighting in sightings:
        try:
            focal_mm = sighting.focal_mm or found_mm
            photos.append(_placed(sighting._replace(focal_mm=focal_mm), flash_cm, ruler_cm / RULER_CM))
        except ValueError as error:
            skipped.append(str(error))
    if len(photos) < 2:
        why = f" ({skipped[0].partition(', expected')[0]})" if skipped else ""
        raise ValueError(
            f"{len(photos)} of {len(paths)} photo{'s' * (len(paths) != 1)} can be used{why}, expected two or more of "
            "one material; take more from other places, with the whole sheet in view."
        )
    photos.sort(key=lambda photo: photo.pose.tilt)
    opening = sightings[0].opening
    resolved = int(opening * photos[0].sighting.scales()[0])
    return Set(photos, skipped, opening * ruler_cm / RULER_CM, min(size, resolved), found_mm)


def _focal_of(fov_rad: float, height: int, width: int) -> float:
    """The focal length in mm as of 35 mm film: the inverse of `data_tools.readers.photos.field_of_view`."""
    return FRAME_MM * min(height, width) / math.hypot(height, width) / 2 / math.tan(fov_rad / 2)


def _check_one_sheet(sightings: Sequence[Sighting]) -> None:
    for sighting in sightings[1:]:
        first = sightings[0]
        if sighting.opening != first.opening:
            raise ValueError(
                f"{sighting.path}: a sheet with an opening of {sighting.opening} cm, expected {first.opening} cm as in "
                f"{first.path.name}; give photos of one material in one sheet."
            )


def _placed(sighting: Sighting, flash_cm: tuple[float, float], scale: float) -> Placed:
    pose = pose_of(sighting, sighting.focal_mm)
    limit_px = LIMIT * sighting.opening * sighting.scales()[1]
    if pose.error_px > limit_px:
        raise ValueError(
            f"{sighting.path}: markers are {pose.error_px:.1f} px from where a lens of {sighting.focal_mm:.0f} mm sees "
            f"them, expected up to {limit_px:.1f}; give the photo uncropped, or the camera's --fov."
        )
    camera = pose.place_cm * scale
    right, up = flash_cm
    return Placed(sighting, pose, camera, camera + right * pose.axes[0] - up * pose.axes[1])


def write_set(placed: Set, folder: Path, done: Callable[[str], object] = str) -> None:
    """Write pictures 00.png, ..., what was found in each, and the texts.

    Args:
        placed: the photographs.
        folder: made if missing; the texts, by which readers know it, are written last.
        done: called with the name of each picture that was written.

    Raises:
        OSError: a file cannot be written.
    """
    for number, photo in enumerate(placed.photos):
        pixels = read_pixels(photo.sighting.path)
        picture = torch.from_numpy(rectified(pixels, photo.sighting, placed.size))
        bits = 8 if pixels.values.dtype == np.uint8 else 16
        name = f"{number:02}.png"
        write_png(picture, {"encoding": "sRGB"}, folder / name, bits)
        write_png(_shown(pixels, photo, name), {"encoding": "sRGB"}, folder / FOUND / name)
        done(name)
    _write_text(folder / SIZE, f"{placed.side_cm:.4f}\n")
    _write_text(folder / LIGHT, _lines([photo.light_cm for photo in placed.photos]))
    _write_text(folder / CAMERA, _lines([photo.camera_cm for photo in placed.photos]))


def _lines(places: Sequence[Floats]) -> str:
    return "".join(",".join(f"{value:.4f}" for value in place) + "\n" for place in places)


def _write_text(path: Path, text: str) -> None:
    write_atomically(path, lambda partial: partial.write_text(text, encoding="utf-8"))


def rectified(pixels: Pixels, sighting: Sighting, size: int) -> NDArray[np.float32]:
    """The opening as a square, sRGB [size, size, 3] in [0, 1], the sheet's upper edge on top.

    Means are taken in linear light over as many samples as the photograph has there.
    """
    cv2 = opencv()
    corners = sighting.corners_px()
    left, top = np.maximum(np.floor(corners.min(0)).astype(int) - 1, 0)
    right, bottom = np.ceil(corners.max(0)).astype(int) + 2
    part = pixels._replace(values=pixels.values[top:bottom, left:right, :3])
    linear = np.ascontiguousarray(linear_light(part, slice(None)))
    many = max(2, math.ceil(sighting.scales()[1] * sighting.opening / size))
    step = sighting.opening / (size * many)  # cm
    middle = (size * many - 1) / 2
    to_cm = np.array([[step, 0, -middle * step], [0, -step, middle * step], [0, 0, 1]])
    to_part = np.array([[1, 0, -left], [0, 1, -top], [0, 0, 1]]) @ sighting.to_px @ to_cm
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    side = size * many
    samples = cv2.warpPerspective(linear, to_part, (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    result = cv2.resize(samples, (size, size), interpolation=cv2.INTER_AREA)
    return linear_to_srgb(torch.from_numpy(result)).numpy()


def _shown(pixels: Pixels, photo: Placed, name: str) -> torch.Tensor:
    """The photograph with the markers and the opening that were found, [H, W, 3] in [0, 1]."""
    cv2 = opencv()
    sighting = photo.sighting
    share = min(1.0, _SHOWN_PX / max(sighting.height, sighting.width))
    size = round(sighting.width * share), round(sighting.height * share)
    values = cv2.resize(np.ascontiguousarray(pixels.values[..., :3]), size, interpolation=cv2.INTER_AREA)
    light = torch.from_numpy(linear_light(pixels._replace(values=values), slice(None)))
    image = (linear_to_srgb(light) * 255).round().to(torch.uint8).numpy()
    for outlines, colour in ((sighting.markers, (0, 200, 0)), (sighting.corners_px()[None], (255, 0, 200))):
        ends = list(((outlines + 0.5) * share).round().astype(np.int32))
        cv2.polylines(image, ends, True, colour, 3)
    words = f"{name}: {summary(photo)}"
    for colour, width in (((0, 0, 0), 4), ((255, 255, 255), 1)):
        cv2.putText(image, words, (8, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.55, colour, width, cv2.LINE_AA)
    return torch.from_numpy(image) / 255


def summary(photo: Placed) -> str:
    """A photograph's markers and camera, in words."""
    distance = float(np.linalg.norm(photo.camera_cm))
    return (
        f"{photo.sighting.path.name}, {len(photo.sighting.markers)} markers, error {photo.pose.error_px:.2f} px, "
        f"camera {distance:.1f} cm away, {photo.pose.tilt:.0f} degrees aside"
    )
