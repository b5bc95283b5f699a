"""Square pieces of one picture that are found again in another one, by normalized cross-correlation.

Where a surface has one colour, or a lamp that moves with the camera shades its relief anew in each photograph, few
local features of two photographs are alike; a piece of many texels still is most alike at its own place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from metapp.extensions.capture.hand_photos import import_opencv
from metapp.extensions.capture.rectified.features import apply_homography, fit_homography
from metapp.extensions.capture.rectified.sheet import Floats

Picture = NDArray[np.float32]

# Near a homography: the side of a piece, how far around its place it is searched, and how far from it the best place
# may be to agree, all in px of a picture of which the shorter side is JUDGED_SIDE_PX.
JUDGED_SIDE_PX = 256
_PIECE_PX, _SEARCH_PX, _MAX_OFFSET_PX = 32, 8, 2.5
# Anywhere: the shorter side of the pictures, the side of a piece, and how far off a piece may be that fits, in px; the
# scales and turns, in degrees, that a picture is tried with.
_COARSE_SIDE_PX, _COARSE_PIECE_PX, _MAX_COARSE_ERROR_PX = 192, 44, 3.0
_TRIED_SCALES, _TRIED_TURNS_DEGREES = (0.8, 1.0, 1.25), (-16.0, 0.0, 16.0)
_MAX_COARSE_GUESSES = 3


class PieceMatches(NamedTuple):
    """Pieces of a reference and where they are most alike in another picture, near a homography.

    Attributes:
        places: the middles of M pieces in the other picture, [M, 2] px.
        reference_places: their middles in the reference, [M, 2] px.
        agreement: the share of all pieces of the reference that are most alike where the homography puts them.
    """

    places: Floats
    reference_places: Floats
    agreement: float


def match_pieces(
    picture: Picture,
    reference: Picture,
    is_compared: Callable[[Floats], NDArray[np.bool_]],
    homography: Floats,
    side_px: int,
) -> PieceMatches:
    """Find the pieces of a reference in another picture, each near the place where a homography puts it.

    Args:
        picture: the other picture, [H, W].
        reference: the reference, [H', W'].
        is_compared: tests which places of the reference, [N, 2] in fractions of width and height, are compared: pieces
            with their middle there.
        homography: takes places of the other picture to places of the reference, [3, 3].
        side_px: to how many px the shorter side of the reference is reduced.
    """
    cv2, search_px = import_opencv(), _SEARCH_PX * side_px // JUDGED_SIDE_PX
    window_px = _PIECE_PX + 2 * search_px
    small_reference, to_small = _shrink(reference, side_px)
    warp = to_small @ homography
    smooth_picture = cv2.GaussianBlur(picture, (0, 0), max(0.5 / to_small[0, 0], 0.1))
    warped, in_view = (
        cv2.warpPerspective(values, warp, small_reference.shape[::-1])
        for values in (smooth_picture, np.ones_like(smooth_picture))
    )
    found_middles, found_offsets, piece_count = [], [], 0
    for top in range(0, small_reference.shape[0] - window_px + 1, _PIECE_PX // 2):
        for left in range(0, small_reference.shape[1] - window_px + 1, _PIECE_PX // 2):
            middle = np.array([left, top]) + (window_px - 1) / 2
            if not is_compared((middle[None] + 0.5) / small_reference.shape[::-1]).all():
                continue
            window, piece_count = np.s_[top : top + window_px, left : left + window_px], piece_count + 1
            if in_view[window].min() > 0.99:
                piece = small_reference[window][search_px:-search_px, search_px:-search_px]
                likeness = cv2.matchTemplate(warped[window], piece, cv2.TM_CCOEFF_NORMED)
                found_middles.append(middle)
                found_offsets.append(_find_peak(likeness) - search_px)
    middles, offsets = np.reshape(found_middles, (-1, 2)), np.reshape(found_offsets, (-1, 2))
    return PieceMatches(
        apply_homography(np.asarray(np.linalg.inv(warp), np.float64), middles + offsets),
        apply_homography(np.asarray(np.linalg.inv(to_small), np.float64), middles),
        float((np.abs(offsets) <= _MAX_OFFSET_PX).all(1).sum()) / max(piece_count, 1),
    )


def guess_by_pieces(
    picture: Picture, reference: Picture, is_compared: Callable[[Floats], NDArray[np.bool_]]
) -> Iterable[Floats]:
    """Yield homographies from a picture to a reference, that of most pieces that fit first.

    Pieces of the reference are searched in the whole picture, at few scales and turns, so that the camera must have
    been held alike. See :func:`match_pieces` for the arguments.
    """
    cv2 = import_opencv()
    (small_picture, to_small_picture), (small_reference, to_small) = (
        _shrink(cv2.GaussianBlur(values, (0, 0), min(values.shape) / _COARSE_SIDE_PX), _COARSE_SIDE_PX)
        for values in (picture, reference)
    )
    height, width = small_reference.shape
    guesses: list[tuple[int, Floats]] = []
    for scale in _TRIED_SCALES:
        for turn_degrees in _TRIED_TURNS_DEGREES:
            middle = (np.array(small_picture.shape[::-1]) - 1) / 2
            turn = np.vstack([cv2.getRotationMatrix2D(middle.tolist(), turn_degrees, scale), [0, 0, 1]])
            turn[:2, 2] += (np.array([width, height]) - 1) / 2 - middle
            turned = cv2.warpPerspective(small_picture, turn, (width, height))
            places, reference_places = [], []
            for top in range(0, height - _COARSE_PIECE_PX + 1, _COARSE_PIECE_PX // 2):
                for left in range(0, width - _COARSE_PIECE_PX + 1, _COARSE_PIECE_PX // 2):
                    if not is_compared((np.array([[left, top]]) + _COARSE_PIECE_PX / 2) / (width, height)).all():
                        continue
                    piece = small_reference[top : top + _COARSE_PIECE_PX, left : left + _COARSE_PIECE_PX]
                    likeness = cv2.matchTemplate(turned, piece, cv2.TM_CCOEFF_NORMED)
                    places.append(_find_peak(likeness))
                    reference_places.append(np.array([left, top]))
            to_middle = (_COARSE_PIECE_PX - 1) / 2
            homography, is_inlier = fit_homography(
                np.reshape(places, (-1, 2)) + to_middle,
                np.reshape(reference_places, (-1, 2)) + to_middle,
                _MAX_COARSE_ERROR_PX,
            )
            guesses.append((int(is_inlier.sum()), np.linalg.inv(to_small) @ homography @ turn @ to_small_picture))
    guesses.sort(key=lambda guess: -guess[0])
    yield from [homography for _, homography in guesses[:_MAX_COARSE_GUESSES]]


def _shrink(picture: Picture, side_px: int) -> tuple[Picture, Floats]:
    """Reduce a picture to a shorter side; return it and the matrix [3, 3] from its px to those of the reduced one."""
    scale = side_px / min(picture.shape)
    small_picture = import_opencv().resize(picture, None, fx=scale, fy=scale, interpolation=import_opencv().INTER_AREA)
    return small_picture, np.array([[scale, 0, (scale - 1) / 2], [0, scale, (scale - 1) / 2], [0, 0, 1]])


def _find_peak(likeness: NDArray[np.float32]) -> Floats:
    """Return the place (x, y) of the largest of values [H, W], to parts of a px by parabolas around it."""
    row, column = divmod(int(likeness.argmax()), likeness.shape[1])
    place = np.array([column, row], np.float64)
    for axis, index, values in ((0, column, likeness[row]), (1, row, likeness[:, column])):
        if 0 < index < len(values) - 1:
            before, peak, after = (float(value) for value in values[index - 1 : index + 2])
            place[axis] += 0.5 * (before - after) / min(before - 2 * peak + after, -1e-9)
    return place.clip(0, np.array(likeness.shape[::-1]) - 1)
