"""Photographs of the marker sheet, rectified to the opening.

They are written to a folder that the format `placed` reads.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from data_tools.readers.flash_places import CAMERA, LIGHT, SIZE
from data_tools.readers.image_files import Pixels, read_pixels
from data_tools.readers.photos import linear_light
from metapp.appearance.colour import linear_to_srgb
from metapp.extensions.capture.markers import opencv
from metapp.extensions.capture.markers.pose import Pose, common_focal, focal_of, pose_of
from metapp.extensions.capture.markers.sheet import RULER_CM, Floats
from metapp.extensions.capture.markers.sighting import Sighting, find_sheet
from metapp.extensions.capture.markers.white import adaptation, paper_colour
from metapp.storage.files import write_atomically
from metapp.storage.images import write_png

LARGEST_PX = 1024
FOUND = "found"  # folder of pictures that show what was found

_ROWS = 128  # made at a time
_SHOWN_PX = 1200  # the longer side of pictures that show what was found


@dataclass(frozen=True)
class Settings:
    """Settings of rectifying photographs.

    Attributes:
        size: greatest side of the pictures in px.
        fov_rad: of the camera along the photographs' shorter side; 0: as EXIF says, else as fits best.
        flash_cm: where the flash is beside the lens: right and up in the photograph.
        ruler_cm: measured length of the printed ruler.
        white: whether pictures are adapted to D65 by the colour of the sheet's paper.
    """

    size: int = LARGEST_PX
    fov_rad: float = 0.0
    flash_cm: tuple[float, float] = (0.0, 0.0)
    ruler_cm: float = RULER_CM
    white: bool = False


class Placed(NamedTuple):
    """A photograph that can be rectified.

    Attributes:
        sighting: the sheet in it.
        pose: of its camera, as if the sheet was printed true to scale.
        camera_cm, light_cm: where camera and flash were, to the sheet's true scale.
        paper: colour of the sheet's paper, linear RGB [3], the greatest 1, that the picture is adapted to D65 by.
    """

    sighting: Sighting
    pose: Pose
    camera_cm: Floats
    light_cm: Floats
    paper: Floats | None = None


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


def place(paths: Sequence[Path], settings: Settings, done: Callable[[str], object] = str) -> Set:
    """Find sheet and camera in photographs.

    Args:
        paths: the photographs, of one sheet.
        settings: how.
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
    without = [sighting for sighting in sightings if not (settings.fov_rad or sighting.focal_mm)]
    focal_mm = common_focal(without) if without else 0.0
    photos = []
    for sighting in sightings:
        try:
            photos.append(_placed(sighting, settings, focal_mm))
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
    side_cm = opening * settings.ruler_cm / RULER_CM
    return Set(photos, skipped, side_cm, min(settings.size, resolved), focal_mm)


def _check_one_sheet(sightings: Sequence[Sighting]) -> None:
    for sighting in sightings[1:]:
        first = sightings[0]
        if sighting.opening != first.opening:
            raise ValueError(
                f"{sighting.path}: a sheet with an opening of {sighting.opening} cm, expected {first.opening} cm as in "
                f"{first.path.name}; give photos of one material in one sheet."
            )


def _placed(sighting: Sighting, settings: Settings, focal_mm: float) -> Placed:
    if settings.fov_rad:
        focal_mm = focal_of(settings.fov_rad, sighting.height, sighting.width)
    elif sighting.focal_mm:
        focal_mm = sighting.focal_mm
    pose = pose_of(sighting, focal_mm)
    if pose.error_px > sighting.limit_px:
        raise ValueError(
            f"{sighting.path}: markers are {pose.error_px:.1f} px from where a lens of {focal_mm:.0f} mm sees them, "
            f"expected up to {sighting.limit_px:.1f}; give the photo uncropped, or the camera's --fov."
        )
    scale = settings.ruler_cm / RULER_CM
    camera = pose.place_cm * scale
    right, up = settings.flash_cm
    paper = paper_colour(read_pixels(sighting.path), sighting) if settings.white else None
    return Placed(sighting, pose, camera, camera + right * pose.axes[0] - up * pose.axes[1], paper)


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
        picture = torch.from_numpy(rectified(pixels, photo.sighting, placed.size, photo.paper))
        bits = 8 if pixels.values.dtype == np.uint8 else 16
        name = f"{number:02}.png"
        write_png(picture, {"encoding": "sRGB"}, folder / name, bits)
        write_png(torch.from_numpy(_shown(pixels, photo, name)), {"encoding": "sRGB"}, folder / FOUND / name)
        done(name)
    _write_text(folder / SIZE, f"{placed.side_cm:.4f}\n")
    _write_text(folder / LIGHT, _lines([photo.light_cm for photo in placed.photos]))
    _write_text(folder / CAMERA, _lines([photo.camera_cm for photo in placed.photos]))


def _lines(places: Sequence[Floats]) -> str:
    return "".join(",".join(f"{value:.4f}" for value in place) + "\n" for place in places)


def _write_text(path: Path, text: str) -> None:
    write_atomically(path, lambda partial: partial.write_text(text, encoding="utf-8"))


def rectified(pixels: Pixels, sighting: Sighting, size: int, paper: Floats | None = None) -> NDArray[np.float32]:
    """The opening as a square, sRGB [size, size, 3] in [0, 1], the sheet's upper edge on top.

    Means are taken in linear light over as many samples as the photograph has there. With the paper's colour, as
    `paper_colour` finds it, the picture is adapted to D65.
    """
    cv2 = opencv()
    corners = sighting.corners_px()
    left, top = np.maximum(np.floor(corners.min(0)).astype(int) - 1, 0)
    right, bottom = np.ceil(corners.max(0)).astype(int) + 2
    part = pixels._replace(values=pixels.values[top:bottom, left:right, :3])
    linear = np.ascontiguousarray(linear_light(part, slice(None)))
    if paper is not None:
        linear = np.minimum(linear, paper.astype(np.float32))
    many = max(2, math.ceil(sighting.scales()[1] * sighting.opening / size))
    step = sighting.opening / (size * many)  # cm
    middle = (size * many - 1) / 2
    to_cm = np.array([[step, 0, -middle * step], [0, -step, middle * step], [0, 0, 1]])
    to_part = np.array([[1, 0, -left], [0, 1, -top], [0, 0, 1]]) @ sighting.to_px @ to_cm
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    result = np.empty((size, size, 3), np.float32)
    for row in range(0, size, _ROWS):
        rows = min(_ROWS, size - row)
        below = np.array([[1, 0, 0], [0, 1, row * many], [0, 0, 1]])
        samples = cv2.warpPerspective(
            linear, to_part @ below, (size * many, rows * many), flags=flags, borderMode=cv2.BORDER_REPLICATE
        )
        result[row : row + rows] = cv2.resize(samples, (size, rows), interpolation=cv2.INTER_AREA)
    if paper is not None:
        result = (result @ adaptation(paper).T).clip(0, 1).astype(np.float32)
    return linear_to_srgb(torch.from_numpy(result)).numpy()


def _shown(pixels: Pixels, photo: Placed, name: str) -> NDArray[np.float32]:
    """The photograph with the markers and the opening that were found, [H, W, 3] in [0, 1]."""
    from PIL import Image, ImageDraw, ImageFont

    cv2 = opencv()
    sighting = photo.sighting
    share = min(1.0, _SHOWN_PX / max(sighting.height, sighting.width))
    size = round(sighting.width * share), round(sighting.height * share)
    values = cv2.resize(np.ascontiguousarray(pixels.values[..., :3]), size, interpolation=cv2.INTER_AREA)
    if values.dtype != np.uint8:
        display = linear_to_srgb(torch.from_numpy(linear_light(pixels._replace(values=values), slice(None)))).numpy()
        values = (display * 255 + 0.5).astype(np.uint8)
    image = Image.fromarray(values)
    draw = ImageDraw.Draw(image)

    def outline(points: Floats, colour: str) -> None:
        ends = [tuple(point) for point in (points + 0.5) * share]
        draw.line([*ends, ends[0], ends[1]], fill=colour, width=3, joint="curve")

    for corners in sighting.points_px.reshape(-1, 4, 2):
        outline(corners, "#00c800")
    outline(sighting.corners_px(), "#ff00c8")
    draw.text(
        (8, 6), f"{name}: {summary(photo)}", "white", ImageFont.load_default(18), stroke_width=3, stroke_fill="black"
    )
    return np.asarray(image, dtype=np.float32) / np.float32(255)


def summary(photo: Placed) -> str:
    """A photograph's markers and camera, in words."""
    distance = float(np.linalg.norm(photo.camera_cm))
    white = "" if photo.paper is None else ", white x " + ", ".join(f"{factor:.2f}" for factor in 1 / photo.paper)
    return (
        f"{photo.sighting.path.name}, {len(photo.sighting.numbers)} markers, error {photo.pose.error_px:.2f} px, "
        f"camera {distance:.1f} cm away, {photo.pose.tilt:.0f} degrees aside{white}"
    )
