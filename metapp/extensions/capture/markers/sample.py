"""The sample that photographs without markers show, separated from the table around it.

A table lies lower than the surface of the sample on it. Where the table is registered in place of the sample, or with
it, maps are wrong. Photographs are compared on planes of many heights (a plane sweep: Collins 1996): on the plane by
which they are registered they agree where the sample is, on another plane where the table is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_tools.readers.image_files import read_pixels
from metapp.extensions.capture.hand_photos import display_values, import_opencv
from metapp.extensions.capture.markers.found_outlines import ignore_outlines
from metapp.extensions.capture.markers.plane import cameras_on_part
from metapp.extensions.capture.markers.rectified_photos import CameraSearch, find_cameras
from metapp.extensions.capture.markers.registration import WHOLE_PHOTO_CORNERS
from metapp.extensions.capture.markers.sheet import Floats
from metapp.extensions.capture.markers.sighting import Camera, Sighting

MIDDLE_CORNERS = (WHOLE_PHOTO_CORNERS + 0.5) / 2  # the part of a photograph where the sample lies, as people aim at it
COMPARISON_SIDE_PX = 192  # side of the compared pictures
# Heights of planes above the plane of registration; a step moves a picture by about a px.
PLANE_HEIGHTS_SIDES = np.arange(-0.36, 0.361, 0.015)
SAME_PLANE_SIDES = 0.045  # planes closer than this count as one: relief and flashes move pictures by as much
# Standard deviations of Gaussians: compared details are finer than the first, windows are as wide as the second.
COMPARISON_DETAIL_PX, COMPARISON_WINDOW_PX = 4.0, 4.0
LOG_FLOOR_OF_WHITE = 0.03  # added to values before the logarithm, which is flat for darker ones
SAMPLE_EDGE_PX = 9  # by which a sample seems wider on each side, as windows beside it hold its edge
MIN_SAMPLE_CORRELATION, MIN_TABLE_CORRELATION = 0.25, 0.35  # of photographs, on the plane of the sample and the table
CORRELATION_NOISE = 0.6  # divided by the root of the number of pairs: the least gain of another plane's correlation
# The least share of the square that is seen as a table, divided by the number of pairs. In five photographs filled by
# the sample, up to 0.0024 of the square seems to be a table. Where a table takes 8 % or more, 0.006 to 0.42 is seen;
# corners of 2 to 6 % are mostly missed, as the edge of the sample is in all windows there.
MIN_TABLE_SHARE = 0.05
MIN_SAMPLE_SHARE = 0.05  # of the common square: a smaller square on the sample is not worth keeping
SQUARE_TURN_DEGREES = 5  # step by which a square is turned to fit the sample


class Agreement(NamedTuple):
    """Where photographs agree on one of two planes.

    Attributes:
        sample: where they agree on the plane by which they are registered, better than on any other one, a mask
            [COMPARISON_SIDE_PX, COMPARISON_SIDE_PX] of the square.
        table: where they agree on another plane, a mask of the same size.
        pairs: the number of pairs of photographs.
    """

    sample: NDArray[np.bool_]
    table: NDArray[np.bool_]
    pairs: int

    @property
    def shows_table(self) -> bool:
        """Whether more than noise lies on another plane."""
        return float(self.table.mean()) > MIN_TABLE_SHARE / self.pairs


def find_sample(
    search: CameraSearch, register: Callable[..., tuple[list[Camera], float, list[str]]] = find_cameras
) -> tuple[list[Camera], float, list[str], float]:
    """Find the cameras of photographs above the marker sheet's opening, or above the largest square on the sample.

    Photographs without markers that show a table are registered once more, by the sample alone.

    Args:
        search: the photographs, what is known of them, and what is called on the way.
        register: a function that finds the cameras, as :func:`find_cameras` does.

    Returns:
        Cameras, focal length and lines about photographs left out, as :func:`find_cameras` returns them; and the share
        of the common square that is kept: 1 where no table is seen, 0 where one is seen and the sample is not found.

    Raises:
        ValueError: :func:`find_cameras` finds no cameras.
    """
    found = register(search)
    search.report_stage("comparing photos on planes of several heights")
    if found[0][0].sighting.shows_sheet or not compare_on_planes(found[0]).shows_table:
        return *found, 1.0
    result = *found, 0.0
    parts = dict.fromkeys(search.paths, MIDDLE_CORNERS)
    reference_paths = [camera.sighting.path for camera in found[0] if camera.sighting.is_reference]
    paths = sorted(search.paths, key=lambda path: path not in reference_paths)  # the reference first
    search_of_sample = replace(search, paths=paths, report_photo=str, keep_outlines=ignore_outlines)
    for _ in range(2):  # first by the middle, then by all of the sample, which is more exact
        try:
            cameras, focal_mm, skipped = register(search_of_sample, parts=parts)
        except ValueError:  # too few features there
            break
        *middle, side, turn_rad = find_largest_square(select_middle_region(compare_on_planes(cameras).sample))
        if side * side < MIN_SAMPLE_SHARE or len(cameras) < len(result[0]) * (result[-1] > 0):
            break
        cameras = cameras_on_part(cameras, middle, side, turn_rad)
        result = cameras, focal_mm, skipped, side * side
        parts |= {camera.sighting.path: _square_in_photo(camera.sighting) for camera in cameras}
    return result


def _square_in_photo(sighting: Sighting) -> Floats:
    """Return the corners [4, 2] of the square, in fractions of the photograph's width and height."""
    return np.asarray((sighting.corners_px() + 0.5) / [sighting.width, sighting.height])


def compare_on_planes(cameras: Sequence[Camera]) -> Agreement:
    """Compare photographs on planes of many heights, over the square that all of them show."""
    pictures = [_log_picture(camera) for camera in cameras]
    scores = np.stack([_correlation(cameras, pictures, height) for height in PLANE_HEIGHTS_SIDES])
    is_same_plane = np.abs(PLANE_HEIGHTS_SIDES) < SAME_PLANE_SIDES
    sample_scores, table_scores = scores[is_same_plane].max(0), scores[~is_same_plane].max(0)
    pairs = math.comb(len(cameras), 2)
    table = (table_scores > MIN_TABLE_CORRELATION) & (
        table_scores > sample_scores + CORRELATION_NOISE / math.sqrt(pairs)
    )
    return Agreement((sample_scores > MIN_SAMPLE_CORRELATION) & (sample_scores >= table_scores), table, pairs)


def select_middle_region(part: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Select the connected region of a mask [H, W] that holds the middle of the picture, without its outermost edge.

    The edge is SAMPLE_EDGE_PX wide. Holes are filled: what lies on the sample belongs to it.
    """
    cv2 = import_opencv()
    _, labels = cv2.connectedComponents(part.astype(np.uint8), connectivity=4)
    middle = labels[tuple(slice(size * 3 // 8, size * 5 // 8) for size in part.shape)]
    inside = middle[middle > 0]
    if not inside.size:
        return np.zeros_like(part)
    region = labels == np.bincount(inside).argmax()
    _, outside = cv2.connectedComponents(np.pad(~region, 1, constant_values=True).astype(np.uint8), connectivity=4)
    filled = (outside[1:-1, 1:-1] != outside[0, 0]).astype(np.uint8)
    edge = np.ones((2 * SAMPLE_EDGE_PX + 1, 2 * SAMPLE_EDGE_PX + 1), np.uint8)
    return np.asarray(cv2.erode(filled, edge, borderType=cv2.BORDER_REPLICATE) > 0)


def find_largest_square(part: NDArray[np.bool_]) -> tuple[float, float, float, float]:
    """Find the largest square in a mask [S, S] of a picture, turned by up to 45 degrees.

    Returns:
        The middle of the square from the middle of the picture, x right and y up, and its side, in sides of the
        picture; its turn counter-clockwise in radians. The side is 0 if the mask is empty.
    """
    cv2, size = import_opencv(), len(part)
    best = 0.0, 0.0, 0.0, 0.0
    margin = math.ceil(size * (math.sqrt(2) - 1) / 2) + 1
    padded, middle = np.pad(part.astype(np.uint8), margin), (size + 2 * margin - 1) / 2
    for degrees in sorted(range(-45, 46, SQUARE_TURN_DEGREES), key=abs):
        turn = cv2.getRotationMatrix2D((middle, middle), -degrees, 1.0)
        turned = cv2.warpAffine(padded, turn, padded.shape, flags=cv2.INTER_NEAREST)
        edge_distance = cv2.distanceTransform(turned, cv2.DIST_C, 3)
        row, column = np.unravel_index(edge_distance.argmax(), edge_distance.shape)
        side = max(2 * float(edge_distance[row, column]) - 1, 0) / size
        if side > best[2]:
            x, y = (column - middle) / size, (middle - row) / size
            cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
            best = cos * x - sin * y, sin * x + cos * y, side, math.radians(degrees)
    return best


def _log_picture(camera: Camera) -> tuple[NDArray[np.float32], Floats]:
    """Return the logarithms of a photograph's grey values, with two px for each px of the compared square.

    Returns:
        The logarithms, [h, w], and the matrix [3, 3] from px of the photograph to px of the logarithms.
    """
    cv2, sighting = import_opencv(), camera.sighting
    grey = display_values(read_pixels(sighting.path)).mean(-1).astype(np.float32)
    scale = min(1.0, 2 * COMPARISON_SIDE_PX / sighting.px_per_cm()[0])
    resized = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    shift = (scale - 1) / 2
    return cv2.GaussianBlur(np.log(resized + LOG_FLOOR_OF_WHITE), (0, 0), 0.8), np.array(
        [[scale, 0, shift], [0, scale, shift], [0, 0, 1]]
    )


def _correlation(
    cameras: Sequence[Camera], pictures: Sequence[tuple[NDArray[np.float32], Floats]], height: float
) -> Floats:
    """Return the mean correlation of pairs of photographs on a plane, in windows around each px of the square.

    Args:
        cameras: the cameras of the photographs.
        pictures: the logarithms of each photograph, and the matrix that :func:`_log_picture` returns.
        height: the height of the plane, in sides of the square.

    Returns:
        The correlation, [COMPARISON_SIDE_PX, COMPARISON_SIDE_PX].
    """
    cv2, middle = import_opencv(), (COMPARISON_SIDE_PX - 1) / 2
    to_square = np.array([[1, 0, -middle], [0, -1, middle], [0, 0, COMPARISON_SIDE_PX]])
    flags, details = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, []
    for camera, (picture, to_logs) in zip(cameras, pictures, strict=True):
        to_picture = to_logs @ camera.projection_matrix(height) @ to_square
        warped, is_inside = (
            cv2.warpPerspective(
                values, to_picture, (COMPARISON_SIDE_PX, COMPARISON_SIDE_PX), flags=flags, borderMode=border
            )
            for values, border in ((picture, cv2.BORDER_REPLICATE), (np.ones_like(picture), cv2.BORDER_CONSTANT))
        )
        detail = warped - cv2.GaussianBlur(warped, (0, 0), COMPARISON_DETAIL_PX)
        detail /= np.sqrt(cv2.GaussianBlur(detail * detail, (0, 0), COMPARISON_DETAIL_PX) + 1e-6)
        details.append(np.where(is_inside > 0.99, detail, np.nan))
    stack = np.stack(details)
    other_photos, stack = np.isfinite(stack).sum(0) - 1, np.nan_to_num(stack)
    own_products = (stack * stack).sum(0)
    pair_products = cv2.GaussianBlur(
        (stack.sum(0) ** 2 - own_products).astype(np.float32), (0, 0), COMPARISON_WINDOW_PX
    )
    max_products = cv2.GaussianBlur(
        (other_photos.clip(0) * own_products).astype(np.float32), (0, 0), COMPARISON_WINDOW_PX
    )
    correlation: Floats = pair_products / (max_products + 1e-3)
    return correlation
