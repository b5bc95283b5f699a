"""Finding the marker sheet in a photograph, and the plane that it lies in."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from data_tools.readers.image_files import Array, Pixels, read_pixels
from metapp.extensions.capture.markers import opencv
from metapp.extensions.capture.markers.sheet import CELLS, Floats, corners_cm, dictionary, opening_of

LIMIT = 1 / 256  # of the opening's side, that markers may be off on average: a texel of a fit
FEWEST = 4  # markers

_SEARCH_PX = 2000  # the longer side of the picture that is searched; corners are then refined in the whole one
_REMEDY = "photograph the whole sheet, sharp and well lit"


class Sighting(NamedTuple):
    """The marker sheet in a photograph; px are of pixel centres, from the upper left one.

    Attributes:
        path: of the photograph.
        height, width: of the upright photograph in px.
        focal_mm: as of 35 mm film; 0 where the file does not say.
        opening: its side as printed, cm.
        numbers: of the markers found.
        points_cm, points_px: their corners [4 N, 2] on the sheet (x right, y up) and in the photograph.
        kept: [4 N], which of these lie in one plane.
        to_px: [3, 3], takes points of the sheet to the photograph.
        error_px: root mean square distance of what is kept from where `to_px` takes it.
    """

    path: Path
    height: int
    width: int
    focal_mm: float
    opening: int
    numbers: list[int]
    points_cm: Floats
    points_px: Floats
    kept: Array
    to_px: Floats
    error_px: float

    @property
    def limit_px(self) -> float:
        """The greatest error of markers."""
        return LIMIT * self.opening * float(self.scales()[1])

    def corners_px(self) -> Floats:
        """Corners of the opening in the photograph [4, 2], round it from the lower left one."""
        return moved(self.to_px, np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * self.opening / 2)

    def scales(self) -> tuple[float, float]:
        """The least and the greatest px per cm within the opening, in any direction."""
        along = np.linspace(-0.5, 0.5, 5) * self.opening
        points = np.array([(x, y) for x in along for y in along])
        step = 1e-3
        columns = [(moved(self.to_px, points + shift) - moved(self.to_px, points)) / step for shift in step * np.eye(2)]
        values = np.linalg.svd(np.stack(columns, -1), compute_uv=False)
        return float(values.min()), float(values.max())


def moved(homography: Floats, points: Floats) -> Floats:
    """Points [N, 2] as a homography [3, 3] moves them."""
    lifted = points @ homography[:, :2].T + homography[:, 2]
    result: Floats = lifted[:, :2] / lifted[:, 2:]
    return result


def find_sheet(path: Path) -> Sighting:
    """Find the sheet in a photograph.

    Raises:
        ValueError: as `read_pixels`; no sheet, or fewer than FEWEST markers of it; these do not lie in a plane or on
            one side of the opening alone; the opening is not wholly in the picture; OpenCV is not installed.
    """
    pixels = read_pixels(path)
    height, width = pixels.values.shape[:2]
    markers = _markers(_gray(pixels))
    opening = opening_of(number for number, _ in markers)
    if opening is None:
        raise ValueError(f"{path}: no marker found, expected those of a marker sheet; {_REMEDY}.")
    on_sheet = corners_cm(opening)
    markers = [(number, corners) for number, corners in markers if number in on_sheet]
    if len(markers) < FEWEST:
        raise ValueError(
            f"{path}: {len(markers)} marker{'s' * (len(markers) != 1)} found, expected {FEWEST} to 12; {_REMEDY}."
        )
    points_cm = np.concatenate([on_sheet[number] for number, _ in markers])
    points_px = np.concatenate([corners for _, corners in markers])
    numbers = [number for number, _ in markers]
    plane = _plane(points_cm, points_px, opening)
    sighting = Sighting(path, height, width, pixels.focal_mm, opening, numbers, points_cm, points_px, *plane)
    _check(sighting)
    return sighting


def _gray(pixels: Pixels) -> Array:
    """The green channel, the sharpest one, as uint8 [height, width] in display values."""
    green = pixels.values[..., 1]
    if green.dtype == np.uint16:
        green = green >> 8
    elif green.dtype != np.uint8:
        green = np.nan_to_num(green).clip(0, 1) ** (1 / 2.2) * 255
    return np.ascontiguousarray(green, dtype=np.uint8)


def _markers(gray: Array) -> list[tuple[int, Floats]]:
    """Numbers and corners [4, 2] in px of all markers in a picture."""
    cv2 = opencv()
    share = min(1.0, _SEARCH_PX / max(gray.shape))
    size = [max(1, round(side * share)) for side in gray.shape[::-1]]
    searched = cv2.resize(gray, size, interpolation=cv2.INTER_AREA) if share < 1 else gray
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    found, numbers, _ = cv2.aruco.ArucoDetector(dictionary(), settings).detectMarkers(searched)
    scale = np.divide(gray.shape[::-1], searched.shape[::-1])
    every = [(corners[0] + 0.5) * scale - 0.5 for corners in found]  # pixel centres
    named = zip(np.ravel(numbers), every, strict=True) if found else ()
    return [(int(number), _refined(gray, corners)) for number, corners in named]


def _refined(gray: Array, corners: Floats) -> Floats:
    """Corners [4, 2] of a marker where its edges cross, to fractions of a pixel, but none of its cells' edges."""
    cv2 = opencv()
    shortest = np.linalg.norm(corners - np.roll(corners, 1, 0), axis=-1).min()
    reach = max(2, round(0.4 * shortest / CELLS))
    ends = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-3)
    refined = cv2.cornerSubPix(gray, corners.astype(np.float32).reshape(4, 1, 2), (reach, reach), (-1, -1), ends)
    result: Floats = refined[:, 0].astype(np.float64)
    return result


def _plane(points_cm: Floats, points_px: Floats, opening: int) -> tuple[Array, Floats, float]:
    """Mask of the corners that lie in a plane, the homography from cm to px, and its root mean square error in px."""
    cv2 = opencv()
    everywhere, _ = cv2.findHomography(points_cm, points_px, 0)
    if everywhere is None:
        return np.zeros(len(points_cm), bool), np.eye(3), math.inf
    reach = moved(everywhere, np.array([[-0.5, 0.0], [0.5, 0.0]]) * opening)
    farthest = max(1.0, 3 * LIMIT * float(np.linalg.norm(reach[1] - reach[0])))
    to_px, kept = cv2.findHomography(points_cm, points_px, cv2.RANSAC, farthest)
    if to_px is None:
        return np.zeros(len(points_cm), bool), np.eye(3), math.inf
    is_kept = kept[:, 0].astype(bool)
    off = moved(to_px, points_cm[is_kept]) - points_px[is_kept]
    return is_kept, to_px, float(np.sqrt((off**2).sum(-1).mean()))


def _check(sighting: Sighting) -> None:
    """Refuse what a photograph cannot be rectified by."""
    path, side = sighting.path, sighting.opening
    flat = "a flat sheet in focus; lay it flat, hold the camera still, or leave this photo out"
    if sighting.kept.mean() < 0.75:
        raise ValueError(
            f"{path}: {sighting.kept.sum()} of {len(sighting.kept)} corners of markers lie in one plane, expected "
            f"nearly all of {flat}."
        )
    if sighting.error_px > sighting.limit_px:
        raise ValueError(
            f"{path}: markers are {sighting.error_px:.1f} px off a plane, expected up to {sighting.limit_px:.1f} of "
            f"{flat}."
        )
    if _hull_area(sighting.points_cm[sighting.kept]) < side**2:
        raise ValueError(f"{path}: markers on one side of the opening alone, expected them all round; {_REMEDY}.")
    corners = sighting.corners_px()
    if (corners < -0.5).any() or (corners > np.array([sighting.width, sighting.height]) - 0.5).any():
        raise ValueError(f"{path}: the opening is not wholly in the picture, expected all of it; {_REMEDY}.")


def _hull_area(points: Floats) -> float:
    cv2 = opencv()
    return float(cv2.contourArea(cv2.convexHull(points.astype(np.float32))))
