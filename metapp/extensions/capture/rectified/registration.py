"""Photographs of a flat material without markers, registered by the material's own details.

Homographies of two photographs are guessed by local features and by pieces, and refined by pieces: a flash beside the
lens shades relief differently in each photograph, so that few features look alike. A homography is judged by the share
of pieces that are most alike where it puts them. Nothing here knows of cameras.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_tools.readers.image_files import read_pixels
from metapp.extensions.capture.hand_photos import display_values, import_opencv
from metapp.extensions.capture.rectified.features import (
    MIN_MATCHES,
    LocalFeatures,
    apply_homography,
    find_features,
    fit_homography,
    match_features,
)
from metapp.extensions.capture.rectified.found_outlines import KeepOutlines, ignore_outlines
from metapp.extensions.capture.rectified.pieces import JUDGED_SIDE_PX, PieceMatches, guess_by_pieces, match_pieces
from metapp.extensions.capture.rectified.sheet import Floats
from metapp.extensions.capture.rectified.sighting import Sighting, diamond_outlines, focal_length_mm

PRINT_MARKERS_ADVICE = "print a frame of markers: metapp data markers sheet.pdf"

_MAX_SIDE_PX = 1600  # longer side of the pictures that are registered
_SCALES, _FEATURES_PER_SCALE = (0.25, 0.5, 1.0), 2500
_MAX_RATIO = 0.9  # the distance of the best match of a feature over the distance of the second best, at most
_MAX_GUESSES = 4  # homographies of two photographs that are tried, by features
_REFINEMENTS = 3  # of a guess
# Shares of the reference's pieces that agree: with photographs of another material at most 0.17 of 79 pairs, of one
# material at least 0.35 where the homography is right. No more guesses are tried above the second.
_MIN_AGREEMENT, _SURE_AGREEMENT = 0.25, 0.6
_MIN_INLIER_SHARE = 0.2  # of pieces in view that fit a homography
_MIN_MIDDLE_GAIN = 1.1  # by which more agrees where the middles of photographs meet, if that is the place
_MIN_FINER_INLIER_SHARE = 0.5  # of pieces of pictures twice as large, which noise makes less alike
_MAX_COMPARED = 4  # placed photographs that a photograph is compared with, so that time grows with the number alone
_MAX_KEPT_MATCHES = 1000  # matches of a photograph by which cameras are found
_MAX_FIT_ERROR_SHARE = 1 / 256  # of the shorter side: how far off a match may be that agrees with a homography
_NOISE_OF_WHITE = 0.008  # contrast below it is not raised to the contrast of the rest

# The corners of a photograph, in fractions of its width and height.
WHOLE_PHOTO_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
MIDDLE_CORNERS = (WHOLE_PHOTO_CORNERS + 0.5) / 2  # the part of a photograph where a sample lies, as people aim at it


class PhotoMatch(NamedTuple):
    """A photograph placed on the reference by a homography; places are px of both registered pictures.

    Attributes:
        homography: the homography [3, 3] from the photograph to the reference.
        places: the places in the photograph of the matches that agree with the homography, [M, 2].
        reference_places: the places of these matches in the reference, [M, 2].
        all_places, all_reference_places: the places of all matches found near the homography, [N, 2] each, those of
            other planes among them.
        agreement: the share of the reference's pieces that the photograph shows where the homography puts them.
    """

    homography: Floats
    places: Floats
    reference_places: Floats
    all_places: Floats
    all_reference_places: Floats
    agreement: float

    def fits(self) -> bool:
        """Test whether enough agrees for two photographs of one surface."""
        min_places = max(3 * MIN_MATCHES, _MIN_INLIER_SHARE * len(self.all_places))
        return self.agreement >= _MIN_AGREEMENT and len(self.places) >= min_places


_NO_PLACES = np.zeros((0, 2))
IDENTITY_MATCH = PhotoMatch(np.eye(3), _NO_PLACES, _NO_PLACES, _NO_PLACES, _NO_PLACES, 1.0)


class PhotoView(NamedTuple):
    """A photograph to register.

    Attributes:
        sighting: the photograph, without points.
        picture: its grey values, [height, width], with equal mean and contrast everywhere.
        features: the features of the picture at several scales.
        part_corners: the corners [4, 2], in fractions of width and height, of the only part by which others are
            registered on the photograph.
    """

    sighting: Sighting
    picture: NDArray[np.float32]
    features: LocalFeatures
    part_corners: Floats = WHOLE_PHOTO_CORNERS

    def to_photo_px(self, points: Floats) -> Floats:
        """Return places [N, 2] of the picture in px of the whole photograph."""
        return np.asarray((points + 0.5) * self.sighting.width / self.picture.shape[1] - 0.5, np.float64)

    def contains(self, places: Floats) -> NDArray[np.bool_]:
        """Test whether places [N, 2], in fractions of width and height, are in the part."""
        sides = np.roll(self.part_corners, -1, 0) - self.part_corners
        to_places = places[:, None] - self.part_corners
        turns = sides[:, 0] * to_places[..., 1] - sides[:, 1] * to_places[..., 0]
        return np.asarray((turns >= 0).all(1) | (turns <= 0).all(1))


class Registration(NamedTuple):
    """Photographs of one material, placed on one of them.

    Attributes:
        views: all photographs, including those that do not fit.
        reference: the index of the photograph that the others are placed on.
        matches: for the index of each photograph that fits, the reference first, its homography and matches.
        agreements: for the index of each photograph that was compared in vain, the largest share of pieces that agreed.
    """

    views: Sequence[PhotoView]
    reference: int
    matches: Mapping[int, PhotoMatch]
    agreements: Mapping[int, float]

    def sightings(self) -> list[Sighting]:
        """Return sightings with the points that photographs share with the reference, which is the first.

        Their `points_cm` are places in the reference: px from its middle divided by its diagonal, y up.
        """
        shared = np.concatenate([match.reference_places for match in self.matches.values()])
        matches = {
            **self.matches,
            self.reference: IDENTITY_MATCH._replace(places=shared, reference_places=shared),
        }
        sightings = [_make_sighting(self.views[i], self.views[self.reference], match) for i, match in matches.items()]
        reference = sightings[0]._replace(is_reference=True, to_px=_coordinates_to_px(sightings[0]))
        return [reference, *sightings[1:]]

    def unmatched_lines(self) -> list[str]:
        """Return a line for each photograph that does not fit."""
        return [
            f"{view.sighting.path}: {_describe_agreement(self.agreements[i])}; {PRINT_MARKERS_ADVICE}."
            for i, view in enumerate(self.views)
            if i not in self.matches
        ]


def register_photos(
    paths: Sequence[Path],
    fov_rad: float = 0.0,
    parts: Mapping[Path, Floats] = MappingProxyType({}),
    report_stage: Callable[[str], object] = str,
    keep_outlines: KeepOutlines = ignore_outlines,
) -> Registration:
    """Find points that photographs of one material share with a reference, the first photograph that another one fits.

    Args:
        paths: the photographs.
        fov_rad: the field of view of their camera along the shorter side; 0 if EXIF is to give it, if it does.
        parts: for some photographs the corners [4, 2] of a convex part, in fractions of width and height from the upper
            left: others are registered on them, and judged, by that part alone.
        report_stage: called with what is done next, in words, before each step that takes a second or more.
        keep_outlines: called with the features that look alike, for each photograph that does not fit.

    Raises:
        ValueError: no two photographs fit, or one cannot be read.
    """
    views = []
    for path in paths:
        report_stage(f"{path.name}: finding features")
        views.append(_make_view(path, fov_rad)._replace(part_corners=parts.get(path, WHOLE_PHOTO_CORNERS)))
    agreements = dict.fromkeys(range(len(views)), 0.0)
    for reference_index, reference in enumerate(views[:-1]):
        matches = {reference_index: IDENTITY_MATCH}
        # Tried twice, as a photo that fits no earlier one may fit one that is placed later; then by the middle alone,
        # as around a sample photos may show a table that lies in another plane.
        for attempt, part_corners in enumerate((reference.part_corners, reference.part_corners, MIDDLE_CORNERS)):
            if attempt == 1 and len(matches) == 1:
                continue  # no photo was placed that others could fit
            part = reference._replace(part_corners=part_corners)
            for other in [other for other in range(reference_index + 1, len(views)) if other not in matches]:
                report_stage(f"{views[other].sighting.path.name}: comparing with {reference.sighting.path.name}")
                for index in select_neighbours(matches, other):
                    view = part if index == reference_index else views[index]
                    guesses = (matches[index].homography @ guess for guess in _guess_homographies(views[other], view))
                    match = _find_match(views[other], part, guesses)
                    if match.fits():
                        matches[other] = match
                        break
                    for compared in (other, reference_index):
                        agreements[compared] = max(agreements[compared], match.agreement)
        if len(matches) > 1:
            unmatched = [view for index, view in enumerate(views) if index not in matches]
            _show_matches(unmatched, reference, report_stage, keep_outlines)
            return Registration(views, reference_index, matches, agreements)
    _show_matches(views, views[0], report_stage, keep_outlines)
    raise ValueError(
        f"{paths[0]}: none of {len(paths)} photos fits another one: {_describe_agreement(max(agreements.values()))}; "
        f"{PRINT_MARKERS_ADVICE}."
    )


def select_neighbours(matches: Mapping[int, PhotoMatch], other: int) -> list[int]:
    """Select the placed photographs, by index, that another one is compared with.

    They are the reference and those that were taken next before or after it, since such photographs overlap most.
    """
    reference, *placed = matches
    return [reference, *sorted(placed, key=lambda index: abs(index - other))][:_MAX_COMPARED]


def change_reference(
    registration: Registration, path: Path, report_stage: Callable[[str], object] = str
) -> Registration:
    """Place photographs on another one of them, starting from the homographies that were found before.

    Args:
        registration: the registration of the photographs.
        path: the photograph to place the others on, one that fits.
        report_stage: called with what is done next, in words, before each step that takes a second or more.

    Returns:
        The registration on that photograph; the one that was given if fewer photographs fit the new reference.
    """
    views = registration.views
    reference_index = next(index for index in registration.matches if views[index].sighting.path == path)
    reference, to_reference = views[reference_index], np.linalg.inv(registration.matches[reference_index].homography)
    matches, agreements = {reference_index: IDENTITY_MATCH}, dict(registration.agreements)
    for index, view in enumerate(views):
        if index != reference_index:
            report_stage(f"{view.sighting.path.name}: comparing with {path.name}, the straightest")
            earlier_match = registration.matches.get(index)
            match = _find_match(
                view,
                reference,
                [to_reference @ earlier_match.homography] if earlier_match else _guess_homographies(view, reference),
            )
            if match.fits():
                matches[index] = match
            else:
                agreements[index] = match.agreement
    return (
        Registration(views, reference_index, matches, agreements)
        if len(matches) >= len(registration.matches)
        else registration
    )


def _describe_agreement(agreement: float) -> str:
    """Return in words how much of another photograph was found in one that does not fit."""
    return (
        f"at most {100 * agreement:.0f} % of another photo found in it, expected {100 * _MIN_AGREEMENT:.0f} % or more"
    )


def _make_view(path: Path, fov_rad: float) -> PhotoView:
    """Read a photograph, even out its mean and contrast, and find its features."""
    cv2, pixels, no_points = import_opencv(), read_pixels(path), np.zeros((0, 2))
    grey = display_values(pixels).mean(-1).astype(np.float32)
    height, width = grey.shape
    sighting = Sighting(
        path, height, width, focal_length_mm(pixels, fov_rad), 1.0, no_points, no_points, no_points, np.eye(3), False
    )
    scale = min(1.0, _MAX_SIDE_PX / max(height, width))
    grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    blur = functools.partial(cv2.GaussianBlur, ksize=(0, 0), sigmaX=min(grey.shape) / 40)
    detail = grey - blur(grey)
    picture = (detail / (np.sqrt(blur(detail * detail)) + _NOISE_OF_WHITE)).clip(-3, 3)
    return PhotoView(sighting, picture, find_features(picture, _SCALES, _FEATURES_PER_SCALE))


def _select_features(features: LocalFeatures, view: PhotoView) -> LocalFeatures:
    """Return the features that lie in the part of a view."""
    is_inside = view.contains((features[0] + 0.5) / view.picture.shape[::-1])
    return features[0][is_inside], features[1][is_inside]


def _guess_homographies(view: PhotoView, other: PhotoView) -> Iterable[Floats]:
    """Yield homographies to another photograph: by features, that of most matches first, then by pieces.

    There are several, as repetitions of a pattern may have more matches than the right homography.
    """
    places, other_places = match_features(view.features, _select_features(other.features, other), _MAX_RATIO)
    for _ in range(_MAX_GUESSES):
        homography, is_inlier = fit_homography(places, other_places, 3.0)
        if is_inlier.sum() < MIN_MATCHES:
            break
        yield homography
        is_outlier = np.linalg.norm(apply_homography(homography, places) - other_places, axis=1) > 12
        places, other_places = places[is_outlier], other_places[is_outlier]
    yield from guess_by_pieces(view.picture, other.picture, other.contains)


def _show_matches(
    views: Sequence[PhotoView], reference: PhotoView, report_stage: Callable[[str], object], keep_outlines: KeepOutlines
) -> None:
    """Show the features of photographs that do not fit a reference: all, those with a match, and those in one plane."""
    for view in views if keep_outlines is not ignore_outlines else []:
        path, longer_px = view.sighting.path, max(view.sighting.height, view.sighting.width)
        report_stage(f"{path.name}: drawing what was found")
        feature_places = view.features[0].astype(np.float64)
        shown_rows = np.random.default_rng(0).permutation(len(feature_places))[:_MAX_KEPT_MATCHES]
        keep_outlines(
            path,
            f"{len(feature_places)} features",
            diamond_outlines(view.to_photo_px(feature_places[shown_rows]), longer_px),
            "orange",
        )
        if view is not reference:
            places, reference_places = match_features(view.features, reference.features, _MAX_RATIO)
            _, is_inlier = fit_homography(places, reference_places, 3.0)
            name = reference.sighting.path.name
            match_text = f"{len(places)} of them with a like one in {name}"
            keep_outlines(path, match_text, diamond_outlines(view.to_photo_px(places), longer_px), "red")
            plane_text = f"{is_inlier.sum()} of these agree with one plane"
            keep_outlines(path, plane_text, diamond_outlines(view.to_photo_px(places[is_inlier]), longer_px), "lime")


def _find_match(view: PhotoView, reference: PhotoView, guesses: Iterable[Floats]) -> PhotoMatch:
    """Return the homography, refined from a guess, by which most of two photographs agrees.

    Args:
        view: the photograph.
        reference: the reference.
        guesses: homographies from the photograph to the reference.
    """
    match = IDENTITY_MATCH._replace(agreement=0.0)
    for guess in guesses:
        match = max(match, _refine_match(view, reference, guess), key=lambda match: match.agreement)
        if match.agreement >= _SURE_AGREEMENT:
            break
    # A pattern that repeats agrees at several places: the one is tried where the middles of both photographs meet.
    view_middle, middle = (
        (np.array([picture.shape[::-1]], np.float64) - 1) / 2 for picture in (view.picture, reference.picture)
    )
    to_middle = np.eye(3)
    to_middle[:2, 2] = (middle - apply_homography(match.homography, view_middle))[0]
    middle_match = _refine_match(view, reference, to_middle @ match.homography)
    if middle_match.agreement >= _MIN_MIDDLE_GAIN * match.agreement:
        match = middle_match
    pieces = match_pieces(view.picture, reference.picture, reference.contains, match.homography, 2 * JUDGED_SIDE_PX)
    finer_match = _fit_match(pieces, _MAX_FIT_ERROR_SHARE * min(reference.picture.shape) / 2)
    is_finer = len(finer_match.places) >= _MIN_FINER_INLIER_SHARE * len(finer_match.all_places)
    return finer_match._replace(agreement=match.agreement) if is_finer else match


def _refine_match(view: PhotoView, reference: PhotoView, homography: Floats) -> PhotoMatch:
    """Return the homography near another one by which pieces of two photographs fit, and how many do."""
    for _ in range(_REFINEMENTS):
        pieces = match_pieces(view.picture, reference.picture, reference.contains, homography, JUDGED_SIDE_PX)
        match = _fit_match(pieces, _MAX_FIT_ERROR_SHARE * min(reference.picture.shape))
        homography = match.homography
    return match


def _fit_match(pieces: PieceMatches, max_error_px: float) -> PhotoMatch:
    """Fit a homography to the pieces of a photograph, by those that are at most so far off, in px."""
    homography, is_inlier = fit_homography(pieces.places, pieces.reference_places, max_error_px)
    return PhotoMatch(
        homography,
        pieces.places[is_inlier],
        pieces.reference_places[is_inlier],
        pieces.places,
        pieces.reference_places,
        pieces.agreement,
    )


def _make_sighting(view: PhotoView, reference: PhotoView, match: PhotoMatch) -> Sighting:
    """Return a photograph's sighting with its matches, on the photograph and on the reference; diamonds mark them."""
    kept_rows, all_rows = (
        np.random.default_rng(0).permutation(len(places))[:_MAX_KEPT_MATCHES]
        for places in (match.places, match.all_places)
    )
    photo_points = view.to_photo_px(match.places[kept_rows])
    return view.sighting._replace(
        markers=diamond_outlines(photo_points, max(view.sighting.height, view.sighting.width)),
        points_cm=reference_coordinates(reference.to_photo_px(match.reference_places[kept_rows]), reference.sighting),
        points_px=photo_points,
        matches_cm=reference_coordinates(
            reference.to_photo_px(match.all_reference_places[all_rows]), reference.sighting
        ),
        matches_px=view.to_photo_px(match.all_places[all_rows]),
    )


def reference_coordinates(points_px: Floats, reference: Sighting) -> Floats:
    """Return places [N, 2] in px of the reference as coordinates: from its middle, y up, 1 is its diagonal."""
    to_coordinates = np.asarray(np.linalg.inv(_coordinates_to_px(reference)), np.float64)
    return apply_homography(to_coordinates, points_px)


def _coordinates_to_px(reference: Sighting) -> Floats:
    """Return the matrix [3, 3] from coordinates, see :func:`reference_coordinates`, to px of the reference."""
    height, width = reference.height, reference.width
    diagonal = math.hypot(height, width)
    return np.array([[diagonal, 0, (width - 1) / 2], [0, -diagonal, (height - 1) / 2], [0, 0, 1]])


def is_in_middle(reference: Sighting, coordinates: Floats) -> NDArray[np.bool_]:
    """Test whether places [N, 2], coordinates of the reference, are in the middle of its photograph."""
    size = np.array([reference.width, reference.height])
    middle_half_size = size * (MIDDLE_CORNERS.max(0) - 0.5)
    return np.asarray((np.abs(coordinates) * np.linalg.norm(size) < middle_half_size).all(-1))


def refit_sightings(sightings: Sequence[Sighting], is_kept: Callable[[Floats], NDArray[np.bool_]]) -> list[Sighting]:
    """Fit the homographies of photographs anew, by some of their matches.

    Args:
        sightings: the photographs on one plane, the reference among them.
        is_kept: tests which matches count, by their coordinates in the reference, [N, 2].

    Returns:
        The photographs with the matches that agree, in coordinates of the reference, which comes first; without those
        of which too few agree.
    """
    reference = next(sighting for sighting in sightings if sighting.is_reference)
    refitted = []
    for sighting in [sighting for sighting in sightings if not sighting.is_reference]:
        places_px = apply_homography(reference.to_px, sighting.matches_cm)
        coordinates = reference_coordinates(places_px, reference)
        rows = np.flatnonzero(is_kept(coordinates))
        max_error_px = _MAX_FIT_ERROR_SHARE * min(sighting.height, sighting.width)
        _, is_inlier = fit_homography(places_px[rows], sighting.matches_px[rows], max_error_px)
        if is_inlier.sum() >= 3 * MIN_MATCHES:
            points_px = sighting.matches_px[rows[is_inlier]]
            refitted.append(
                sighting._replace(
                    markers=diamond_outlines(points_px, max(sighting.height, sighting.width)),
                    points_cm=coordinates[rows[is_inlier]],
                    points_px=points_px,
                    matches_cm=coordinates,
                )
            )
    shared = np.concatenate([np.zeros((0, 2)), *(sighting.points_cm for sighting in refitted)])
    to_px = _coordinates_to_px(reference)
    points_px = apply_homography(to_px, shared)
    placed = reference._replace(points_cm=shared, points_px=points_px, matches_cm=shared[:0], to_px=to_px)
    return [placed, *refitted]
