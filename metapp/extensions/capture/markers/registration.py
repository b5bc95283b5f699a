"""Photographs of a flat material without markers, registered by the material's own features.

Features are SIFT's (Lowe 2004), homographies MAGSAC++'s (Barath et al. 2020). A flash beside the lens shades relief
anew in each photograph, so that few features look alike: many are compared, and a homography is judged by other means,
the share of small pieces of both pictures that are most alike in the same place.
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
from metapp.extensions.capture.markers.found_outlines import KeepOutlines, ignore_outlines
from metapp.extensions.capture.markers.sheet import Floats
from metapp.extensions.capture.markers.sighting import Sighting, diamond_outlines, focal_length_mm

PRINT_MARKERS_ADVICE = "print a frame of markers: metapp data markers sheet.pdf"

_LONGER_PX = 1600  # side of the pictures that are registered, at most
_LEVELS, _FEATURES, _GUIDED = (1.0, 0.5, 0.25), 2500, 5000  # scales, features of each; of one scale, near a first guess
_LIKE = 0.9, 0.75  # distance of the best match over that of the second, at most: anywhere, and near a first guess
_TRIES, _FEWEST = 4, 10  # homographies of two photographs that are tried, matches of each
_NEAR = 0.025  # of the shorter side, how far off a first guess is
_PIECES_PX, _PIECE, _REACH, _OFF = 256, 32, 8, 2  # shorter side of pictures that are judged, pieces, search, errors, px
_LEAST = 0.35  # share of pieces that agree, and of the reference in view
_RIGHT = 0.5  # least share of matches near a first guess that fit
_KEPT = 1000  # matches of a photograph
_NOISE = 0.008  # of white: less contrast is not raised to that of the rest

LocalFeatures = tuple[NDArray[np.float32], NDArray[np.float32]]  # places [N, 2] in px, descriptors [N, 128] of length 1
WHOLE_PHOTO_CORNERS = np.array(
    [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
)  # a photograph's corners, in fractions of its sides
PhotoMatch = tuple[
    Floats, Floats, Floats
]  # [3, 3] from px of a photograph to the reference's, matches [N, 2] in px of both
IDENTITY_MATCH: PhotoMatch = np.eye(3), np.zeros((0, 2)), np.zeros((0, 2))


class PhotoView(NamedTuple):
    """A photograph to register.

    Attributes:
        sighting: the photograph, without points.
        picture: [height, width], grey, of like mean and contrast everywhere.
        features: of the picture at several scales.
        part: the only part by which others are registered on it, corners [4, 2] in fractions of width and height.
    """

    sighting: Sighting
    picture: NDArray[np.float32]
    features: LocalFeatures
    part: Floats = WHOLE_PHOTO_CORNERS

    def in_photo(self, points: Floats) -> Floats:
        """Return places [N, 2] of the picture in px of the whole photograph."""
        return np.asarray((points + 0.5) * self.sighting.width / self.picture.shape[1] - 0.5, np.float64)

    def holds(self, places: Floats) -> NDArray[np.bool_]:
        """Test whether places [N, 2], in fractions of width and height, are in the part."""
        sides = np.roll(self.part, -1, 0) - self.part
        to_places = places[:, None] - self.part
        turns = sides[:, 0] * to_places[..., 1] - sides[:, 1] * to_places[..., 0]
        return np.asarray((turns >= 0).all(1) | (turns <= 0).all(1))


class Registration(NamedTuple):
    """Photographs of one material, placed on one of them.

    Attributes:
        views: all photographs, those that do not fit, too.
        reference: number of the photograph that the others are placed on.
        placed: by the numbers of the photographs that fit, the reference first, their homographies and matches.
    """

    views: Sequence[PhotoView]
    reference: int
    placed: Mapping[int, PhotoMatch]

    def sightings(self) -> list[Sighting]:
        """Return the points that photographs share with the reference, which is the first.

        Their `points_cm` are those of the reference, px from its middle over its diagonal, y up.
        """
        shared = np.concatenate([match[2] for match in self.placed.values()])
        matches = {**self.placed, self.reference: (np.eye(3), shared, shared)}
        sightings = [_sighted(self.views[i], self.views[self.reference], match) for i, match in matches.items()]
        return [sightings[0]._replace(reference=True), *sightings[1:]]

    def lost(self) -> list[str]:
        """Return a line for each photograph that does not fit."""
        name = self.views[self.reference].sighting.path.name
        why = f"too few features in common with {name}, expected an overlap; {PRINT_MARKERS_ADVICE}."
        return [f"{view.sighting.path}: {why}" for i, view in enumerate(self.views) if i not in self.placed]


def register_photos(
    paths: Sequence[Path],
    fov_rad: float = 0.0,
    parts: Mapping[Path, Floats] = MappingProxyType({}),
    begin: Callable[[str], object] = str,
    show: KeepOutlines = ignore_outlines,
) -> Registration:
    """Find points that photographs of one material share with a reference, the first that another one fits.

    Args:
        paths: the photographs.
        fov_rad: of their camera along the shorter side; 0: as EXIF says, if it does.
        parts: of some photographs the only part by which others are registered on them, and judged: corners [4, 2] of
            a convex one, in fractions of width and height from the upper left.
        begin: called with what is done next, in words, before each step that takes a second or more.
        show: called with the features that look alike, of each photograph that does not fit.

    Raises:
        ValueError: no two fit; as `read_pixels`.
    """
    views = []
    for path in paths:
        begin(f"{path.name}: finding features")
        views.append(_view(path, fov_rad)._replace(part=parts.get(path, WHOLE_PHOTO_CORNERS)))
    for first, reference in enumerate(views[:-1]):
        fine = _within(_features(reference.picture, _LEVELS[:1], _GUIDED), reference)
        placed: dict[int, PhotoMatch] = {first: IDENTITY_MATCH}
        for other in [*range(first + 1, len(views))] * 2:  # one that fits no earlier photograph may fit a later one
            if other not in placed:
                begin(f"{views[other].sighting.path.name}: comparing with {reference.sighting.path.name}")
            for number in [] if other in placed else list(placed):
                guesses = [placed[number][0] @ each for each in _guesses(views[other], views[number])]
                match = _best(views[other], reference, fine, guesses)
                if match:
                    placed[other] = match
                    break
        if len(placed) > 1:
            lost = [view for number, view in enumerate(views) if number not in placed]
            _show_alike(lost, reference, begin, show)
            return Registration(views, first, placed)
    _show_alike(views, views[0], begin, show)
    raise ValueError(
        f"{paths[0]}: none of {len(paths)} photos has features in common with another one; {PRINT_MARKERS_ADVICE}."
    )


def change_reference(registration: Registration, path: Path, begin: Callable[[str], object] = str) -> Registration:
    """Place photographs on another one of them, those placed before near where their homographies put them.

    Args:
        registration: of the photographs.
        path: of the photograph to place them on, one that fits.
        begin: called with what is done next, in words, before each step that takes a second or more.

    Returns:
        The registration on that photograph; the one given if fewer photographs fit that photograph.
    """
    views = registration.views
    first = next(number for number in registration.placed if views[number].sighting.path == path)
    reference, to_first = views[first], np.linalg.inv(registration.placed[first][0])
    fine = _within(_features(reference.picture, _LEVELS[:1], _GUIDED), reference)
    placed: dict[int, PhotoMatch] = {first: IDENTITY_MATCH}
    for number, view in enumerate(views):
        if number != first:
            begin(f"{view.sighting.path.name}: comparing with {path.name}, the straightest")
            known = registration.placed.get(number)
            match = _best(view, reference, fine, [to_first @ known[0]] if known else _guesses(view, reference))
            if match:
                placed[number] = match
    return Registration(views, first, placed) if len(placed) >= len(registration.placed) else registration


def _view(path: Path, fov_rad: float) -> PhotoView:
    cv2, pixels, none = import_opencv(), read_pixels(path), np.zeros((0, 2))
    grey = display_values(pixels).mean(-1).astype(np.float32)
    height, width = grey.shape
    sighting = Sighting(path, height, width, focal_length_mm(pixels, fov_rad), 1.0, none, none, none, np.eye(3), False)
    scale = min(1.0, _LONGER_PX / max(height, width))
    grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    near = functools.partial(cv2.GaussianBlur, ksize=(0, 0), sigmaX=min(grey.shape) / 40)
    rest = grey - near(grey)
    picture = (rest / (np.sqrt(near(rest * rest)) + _NOISE)).clip(-3, 3)
    return PhotoView(sighting, picture, _features(picture, _LEVELS, _FEATURES))


def _features(picture: NDArray[np.float32], levels: Sequence[float], count: int) -> LocalFeatures:
    """So many of SIFT's features at most of each scale, described as RootSIFT does."""
    cv2, places, descriptors = import_opencv(), [np.zeros((0, 2), np.float32)], [np.zeros((0, 128), np.float32)]
    sift = cv2.SIFT_create(count, contrastThreshold=0.01, edgeThreshold=20)
    for level in levels:
        small = cv2.resize(picture, None, fx=level, fy=level, interpolation=cv2.INTER_AREA)
        small = small / max(float(small.std()), 0.1) if level < 1 else cv2.GaussianBlur(small, (0, 0), 1.0)
        points, described = sift.detectAndCompute(((small + 3) * 42.5).clip(0, 255).astype(np.uint8), None)
        if points:
            places.append((np.array([point.pt for point in points], np.float32) + 0.5) / level - 0.5)
            descriptors.append(np.sqrt(described / np.maximum(described.sum(1, keepdims=True), 1e-6)))
    return np.concatenate(places), np.concatenate(descriptors)


def _pairs(one: LocalFeatures, other: LocalFeatures, like: float, near: float) -> tuple[Floats, Floats]:
    """Places [M, 2] of features that are most alike of those within so many px of each other."""
    if not len(one[0]) or not len(other[0]):
        return np.zeros((0, 2)), np.zeros((0, 2))
    alike, rows = one[1] @ other[1].T, np.arange(len(one[0]))
    squares = (one[0] ** 2).sum(1)[:, None] + (other[0] ** 2).sum(1) - 2 * one[0] @ other[0].T
    alike[squares > near * near] = 0.0
    best, back = alike.argmax(1), alike.argmax(0)
    value = alike[rows, best]
    alike[rows, best] = 0.0
    kept = (back[best] == rows) & (1 - value < like * like * (1 - alike.max(1))) & (value > 0.5)
    return one[0][kept].astype(np.float64), other[0][best[kept]].astype(np.float64)


def _homography(own: Floats, on_reference: Floats, off_px: float) -> tuple[Floats, NDArray[np.bool_]]:
    """The homography that most matches fit, [3, 3], and which of them do, [N]."""
    to, kept = np.eye(3), None
    if len(own) >= _FEWEST:
        to, kept = import_opencv().findHomography(
            own, on_reference, import_opencv().USAC_MAGSAC, off_px, None, 20_000, 0.9999
        )
    return (to, kept[:, 0] > 0) if kept is not None and to is not None else (np.eye(3), np.zeros(len(own), bool))


def _within(features: LocalFeatures, view: PhotoView) -> LocalFeatures:
    """Return the features that lie in the part of a view."""
    kept = view.holds((features[0] + 0.5) / view.picture.shape[::-1])
    return features[0][kept], features[1][kept]


def _guesses(view: PhotoView, other: PhotoView) -> Iterable[Floats]:
    """Homographies to another photograph, that of most matches first: repetitions may outnumber the right one."""
    own, there = _pairs(view.features, _within(other.features, other), _LIKE[0], math.inf)
    for _ in range(_TRIES):
        to, kept = _homography(own, there, 3.0)
        if kept.sum() < _FEWEST:
            break
        yield to
        far = np.linalg.norm(apply_homography(to, own) - there, axis=1) > 12
        own, there = own[far], there[far]


def _show_alike(
    views: Sequence[PhotoView], reference: PhotoView, begin: Callable[[str], object], show: KeepOutlines
) -> None:
    """Show the features of photographs that do not fit a reference: all, those alike, and of these those in a plane."""
    for view in views if show is not ignore_outlines else []:
        path, longer_px = view.sighting.path, max(view.sighting.height, view.sighting.width)
        begin(f"{path.name}: drawing what was found")
        places = view.features[0].astype(np.float64)
        chosen = np.random.default_rng(0).permutation(len(places))[:_KEPT]
        show(path, f"{len(places)} features", diamond_outlines(view.in_photo(places[chosen]), longer_px), "orange")
        if view is not reference:
            own, there = _pairs(view.features, reference.features, _LIKE[0], math.inf)
            _, kept = _homography(own, there, 3.0)
            name = reference.sighting.path.name
            alike = f"{len(own)} of them with a like one in {name}"
            show(path, alike, diamond_outlines(view.in_photo(own), longer_px), "red")
            in_plane = f"{kept.sum()} of these agree with one plane"
            show(path, in_plane, diamond_outlines(view.in_photo(own[kept]), longer_px), "lime")


def _best(view: PhotoView, reference: PhotoView, fine: LocalFeatures, guesses: Iterable[Floats]) -> PhotoMatch | None:
    """The guess by which most of two photographs agrees, refined twice by fine features near it."""
    size = reference.picture.shape[::-1]
    to = max(guesses, key=lambda to: math.prod(_agreement(view, reference, to)), default=np.zeros((3, 3)))
    for step in range(3):
        if not to.any() or min(_agreement(view, reference, to)) < _LEAST:
            return None
        if step < 2:
            warped = import_opencv().warpPerspective(view.picture, to, size, flags=import_opencv().INTER_CUBIC)
            there, moved = _pairs(fine, _features(warped, _LEVELS[:1], _GUIDED), _LIKE[1], _NEAR * min(size))
            own = apply_homography(np.asarray(np.linalg.inv(to), np.float64), moved)
            to, kept = _homography(own, there, 2.0)
    return (to, own[kept], there[kept]) if kept.sum() >= max(3 * _FEWEST, _RIGHT * len(kept)) else None


def _agreement(view: PhotoView, reference: PhotoView, to: Floats) -> tuple[float, float]:
    """Shares of pieces of the reference: of those in view, that are most alike in the same place; of all, in view."""
    cv2, scale, margin = import_opencv(), _PIECES_PX / min(reference.picture.shape), _PIECE + 2 * _REACH
    small = cv2.resize(reference.picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    warp = np.array([[scale, 0, (scale - 1) / 2], [0, scale, (scale - 1) / 2], [0, 0, 1]]) @ to
    smooth = cv2.GaussianBlur(view.picture, (0, 0), max(0.5 / scale, 0.1))
    warped, inside = (cv2.warpPerspective(each, warp, small.shape[::-1]) for each in (smooth, np.ones_like(smooth)))
    total, seen, good = 0, 0, 0
    for top in range(0, small.shape[0] - margin, _PIECE // 2):
        for left in range(0, small.shape[1] - margin, _PIECE // 2):
            if not reference.holds((np.array([[left, top]]) + margin / 2) / small.shape[::-1]).all():
                continue
            wide, total = np.s_[top : top + margin, left : left + margin], total + 1
            if inside[wide].min() > 0.99:
                piece = small[wide][_REACH:-_REACH, _REACH:-_REACH]
                place = cv2.minMaxLoc(cv2.matchTemplate(warped[wide], piece, cv2.TM_CCOEFF_NORMED))[3]
                seen, good = seen + 1, good + (max(abs(each - _REACH) for each in place) <= _OFF)
    return good / max(seen, 1), seen / max(total, 1)


def _sighted(view: PhotoView, reference: PhotoView, match: PhotoMatch) -> Sighting:
    """The matches of a photograph, in px of the whole photograph, and on the reference; marks of them are diamonds."""
    chosen = np.random.default_rng(0).permutation(len(match[1]))[:_KEPT]
    own, there = view.in_photo(match[1][chosen]), reference.in_photo(match[2][chosen])
    height, width = reference.sighting.height, reference.sighting.width
    points = (there - [(width - 1) / 2, (height - 1) / 2]) * [1, -1] / math.hypot(height, width)
    marks = diamond_outlines(own, max(view.sighting.height, view.sighting.width))
    return view.sighting._replace(markers=marks, points_cm=points, points_px=own)


def apply_homography(homography: Floats, points: Floats) -> Floats:
    """Points [N, 2] that a homography moves."""
    moved = np.pad(points, ((0, 0), (0, 1)), constant_values=1.0) @ homography.T
    return np.asarray(moved[:, :2] / moved[:, 2:], np.float64)
