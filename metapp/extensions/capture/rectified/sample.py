"""The sample that photographs without markers show, separated from the table around it.

A table lies lower than the surface of the sample on it. Where the table is registered in place of the sample, or with
it, maps are wrong. A table that is little lower is told by matches: on the plane of the sample, which is found by the
matches in the middle, those of the table have a height below 0. One that is much lower has no matches near; it is told
by comparing photographs on planes of many heights (a plane sweep: Collins 1996): on the plane by which they are
registered they agree where the sample is, on another plane where the table is.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from data_tools.readers.image_files import read_pixels
from metapp.extensions.capture.hand_photos import display_values, import_opencv
from metapp.extensions.capture.rectified.features import apply_homography
from metapp.extensions.capture.rectified.found_outlines import ignore_outlines
from metapp.extensions.capture.rectified.plane import cameras_on_part
from metapp.extensions.capture.rectified.rectified_photos import CameraSearch, find_cameras, fit_cameras
from metapp.extensions.capture.rectified.registration import (
    MIDDLE_CORNERS,
    is_in_middle,
    reference_coordinates,
    refit_sightings,
)
from metapp.extensions.capture.rectified.sheet import Floats
from metapp.extensions.capture.rectified.sighting import Camera, Sighting

COMPARISON_SIDE_PX = 192  # side of the compared pictures
# Heights of planes above the plane of registration; a step moves a picture by about a px.
PLANE_HEIGHTS_SIDES = np.arange(-0.36, 0.361, 0.015)
SAME_PLANE_SIDES = 0.04  # planes closer than this count as one: shading moves pictures by as much
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
LOWER_PLANE_FITS = 3  # times that photographs are placed by matches on the sample
# A match lies lower than the sample if its height is below 0 by so many standard deviations of the sample's matches,
# and by so many sides of the square. A normal distribution's median absolute value is 0.6745 standard deviations.
MIN_LOWER_DEVIATIONS, MIN_LOWER_SIDES, MEDIAN_OF_NORMAL = 4.0, 0.004, 0.6745
HEIGHT_STEP = 0.01  # sides of the square by which planes are moved to differentiate projections
MAX_ACROSS_SHARE = 0.002  # distance of a match from its epipolar line, over the photograph's longer side, at most
VOTING_MATCHES = 9  # nearest matches that decide together whether a place is on the table
MIN_LOWER_SHARE = 0.05  # of the matches, from which on they show a table
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

    Photographs without markers that show a table are placed once more, by the sample alone.

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
    if found[0][0].sighting.shows_sheet:
        return *found, 1.0
    search.report_stage("heights of matches")
    if cut := cut_lower_matches(found, search):
        return cut
    search.report_stage("comparing photos on planes of several heights")
    if not compare_on_planes(found[0]).shows_table:
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


def cut_lower_matches(
    found: tuple[list[Camera], float, list[str]], search: CameraSearch
) -> tuple[list[Camera], float, list[str], float] | None:
    """Place photographs by the sample alone and cut them to it, where matches lie lower than those in the middle.

    Photographs are placed anew by the matches in the middle of the reference, where the sample lies; then, twice, by
    all matches that do not lie lower than the sample.

    Args:
        found: what :func:`find_cameras` returns.
        search: the photographs.

    Returns:
        What :func:`find_sample` returns; None where no matches lie lower, or no square on the sample is found.
    """
    cameras, focal_mm, skipped = found
    if not any(camera.sighting.is_reference for camera in cameras):  # it was left out
        return None
    is_sample: Callable[[Floats], NDArray[np.bool_]] = functools.partial(
        is_in_middle, _find_reference(cameras).sighting
    )
    result = None
    for _ in range(LOWER_PLANE_FITS):
        refitted_cameras, misfits = _refit_cameras(cameras, is_sample, search)
        if len(refitted_cameras) < len(cameras):
            return result
        cameras = refitted_cameras
        heights = measure_heights(cameras, is_sample)
        if result is None and heights.shows_lower(heights.places).mean() < MIN_LOWER_SHARE:
            return None
        lower = heights.shows_lower(_square_places(_find_reference(cameras)))
        *middle, side, turn_rad = find_largest_square(select_middle_region(~lower)) if lower.any() else (0, 0, 1, 0)
        if side * side < MIN_SAMPLE_SHARE:
            return result
        result = cameras_on_part(cameras, middle, side, turn_rad), focal_mm, [*skipped, *misfits], side * side
        is_sample = heights.shows_sample
    return result


class MatchHeights(NamedTuple):
    """Matches of photographs with the reference, and which of them lie lower than the sample.

    Attributes:
        places: their places in the reference, [M, 2] as :func:`reference_coordinates` returns them.
        is_lower: which of them lie lower, [M].
    """

    places: Floats
    is_lower: NDArray[np.bool_]

    def shows_lower(self, places: Floats) -> NDArray[np.bool_]:
        """Test whether the reference shows something lower than the sample at places [..., 2].

        The nearest VOTING_MATCHES matches of each place decide together.
        """
        _, nearest = cKDTree(self.places).query(places, min(VOTING_MATCHES, len(self.places)))
        return np.asarray(self.is_lower[nearest].mean(-1) > 0.5)

    def shows_sample(self, places: Floats) -> NDArray[np.bool_]:
        """Test whether the reference shows the sample at places [..., 2]."""
        return ~self.shows_lower(places)


def _find_reference(cameras: Sequence[Camera]) -> Camera:
    """Return the camera on whose photograph the others are registered."""
    return next(camera for camera in cameras if camera.sighting.is_reference)


def _square_places(reference: Camera) -> Floats:
    """Return where the reference sees the square, coordinates [COMPARISON_SIDE_PX, COMPARISON_SIDE_PX, 2]."""
    ticks = (np.arange(COMPARISON_SIDE_PX) + 0.5) / COMPARISON_SIDE_PX - 0.5
    grid = np.stack(np.meshgrid(ticks, -ticks), -1).reshape(-1, 2) * reference.sighting.opening_cm
    places = reference_coordinates(apply_homography(reference.sighting.to_px, grid), reference.sighting)
    return places.reshape(COMPARISON_SIDE_PX, COMPARISON_SIDE_PX, 2)


def _refit_cameras(
    cameras: Sequence[Camera], is_sample: Callable[[Floats], NDArray[np.bool_]], search: CameraSearch
) -> tuple[list[Camera], list[str]]:
    """Find cameras anew by the matches on the sample.

    Args:
        cameras: the cameras of the photographs.
        is_sample: tests whether places in the reference, coordinates [N, 2], show the sample.
        search: the photographs.

    Returns:
        The cameras, the one from nearest to straight above first, and lines about photographs left out; no cameras
        where a photograph has too few matches there, or photographs share no square.
    """
    sightings = refit_sightings([camera.sighting for camera in cameras], is_sample)
    if len(sightings) < len(cameras):
        return [], []
    try:
        fitted, _, misfits = fit_cameras(sightings, search)
    except ValueError:  # photographs share no square
        return [], []
    return sorted(fitted, key=lambda camera: camera.view_angle_degrees), misfits


def measure_heights(cameras: Sequence[Camera], is_sample: Callable[[Floats], NDArray[np.bool_]]) -> MatchHeights:
    """Measure which matches of photographs with the reference lie lower than the plane of the sample.

    Args:
        cameras: the cameras of the photographs.
        is_sample: tests whether places in the reference, coordinates [N, 2], show the sample, whose matches tell how
            far heights scatter.
    """
    reference, parts = _find_reference(cameras), []
    for camera in cameras:
        sighting, points = camera.sighting, camera.sighting.matches_cm
        if sighting.is_reference:
            continue
        # Height moves a match along its epipolar line: the difference of both projections is twice the step's movement.
        above, below = (_project_ray(camera, reference, points, step) for step in (HEIGHT_STEP, -HEIGHT_STEP))
        along, offset = (above - below) / 2, sighting.matches_px - (above + below) / 2
        step_px = np.linalg.norm(along, axis=1)
        height_px = (offset * along).sum(1) / step_px
        across_px = np.abs(offset[:, 0] * along[:, 1] - offset[:, 1] * along[:, 0]) / step_px
        places = reference_coordinates(apply_homography(reference.sighting.to_px, points), reference.sighting)
        kept = across_px < MAX_ACROSS_SHARE * max(sighting.height, sighting.width)
        on_sample = kept & is_sample(places)
        deviation_px = (
            float(np.median(np.abs(height_px[on_sample]))) / MEDIAN_OF_NORMAL if on_sample.any() else math.inf
        )
        is_lower = (height_px < -MIN_LOWER_DEVIATIONS * deviation_px) & (
            height_px / step_px * HEIGHT_STEP < -MIN_LOWER_SIDES
        )
        parts.append((places[kept], is_lower[kept]))
    places, is_lower = map(np.concatenate, zip(*parts, strict=True))
    return MatchHeights(places, is_lower)


def _project_ray(camera: Camera, reference: Camera, points: Floats, height: float) -> Floats:
    """Return where a photograph shows what the reference sees at points [N, 2] of the plane, if it lies higher: px."""
    eye = reference.place_cm
    return apply_homography(camera.projection_matrix(height), points + (eye[:2] - points) * height / eye[2])


def _square_in_photo(sighting: Sighting) -> Floats:
    """Return the corners [4, 2] of the square, in fractions of the photograph's width and height."""
    return np.asarray((sighting.corners_px() + 0.5) / [sighting.width, sighting.height])


def measure_agreement(cameras: Sequence[Camera]) -> float:
    """Return the share of the square in which photographs agree on the plane by which they are registered."""
    correlation = _correlation(cameras, [_log_picture(camera) for camera in cameras], 0.0)
    return float((correlation > MIN_SAMPLE_CORRELATION).mean())


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
