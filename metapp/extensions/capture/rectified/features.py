"""Local features of two pictures that look alike, and the homographies that take one picture to the other.

Features are SIFT's (Lowe 2004), described as RootSIFT describes them; homographies are MAGSAC++'s (Barath et al. 2020).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metapp.extensions.capture.hand_photos import import_opencv
from metapp.extensions.capture.rectified.sheet import Floats

MIN_MATCHES = 10  # of two photographs, by which a homography is fitted

# Places [N, 2] in px, and descriptors [N, 128] of length 1.
LocalFeatures = tuple[NDArray[np.float32], NDArray[np.float32]]


def find_features(picture: NDArray[np.float32], levels: Sequence[float], count: int) -> LocalFeatures:
    """Find at most `count` of SIFT's features at each scale, described as RootSIFT describes them."""
    cv2, places, descriptors = import_opencv(), [np.zeros((0, 2), np.float32)], [np.zeros((0, 128), np.float32)]
    sift = cv2.SIFT_create(count, contrastThreshold=0.01, edgeThreshold=20)
    for level in levels:
        resized = cv2.resize(picture, None, fx=level, fy=level, interpolation=cv2.INTER_AREA)
        # Noise has features of its own, which hide the few of a surface of one colour: smoothed first.
        resized = cv2.GaussianBlur(resized, (0, 0), 1.0)
        resized /= max(float(resized.std()), 0.1)
        points, sift_descriptors = sift.detectAndCompute(((resized + 3) * 42.5).clip(0, 255).astype(np.uint8), None)
        if points:
            places.append((np.array([point.pt for point in points], np.float32) + 0.5) / level - 0.5)
            descriptors.append(np.sqrt(sift_descriptors / np.maximum(sift_descriptors.sum(1, keepdims=True), 1e-6)))
    return np.concatenate(places), np.concatenate(descriptors)


def match_features(first: LocalFeatures, second: LocalFeatures, max_ratio: float) -> tuple[Floats, Floats]:
    """Match features of two pictures that are most alike, each to the other.

    Args:
        first: the features of the first picture.
        second: the features of the second picture.
        max_ratio: the distance of the best match over the distance of the second best, at most.

    Returns:
        The places of M matches in both pictures, [M, 2] px each.
    """
    if not len(first[0]) or not len(second[0]):
        return np.zeros((0, 2)), np.zeros((0, 2))
    similarity, rows = first[1] @ second[1].T, np.arange(len(first[0]))
    best, best_back = similarity.argmax(1), similarity.argmax(0)
    best_similarity = similarity[rows, best]
    similarity[rows, best] = 0.0
    is_match = (
        (best_back[best] == rows)
        & (1 - best_similarity < max_ratio * max_ratio * (1 - similarity.max(1)))
        & (best_similarity > 0.5)
    )
    return first[0][is_match].astype(np.float64), second[0][best[is_match]].astype(np.float64)


def fit_homography(places: Floats, reference_places: Floats, max_error_px: float) -> tuple[Floats, NDArray[np.bool_]]:
    """Fit a homography to as many matches as possible.

    Args:
        places: the places of matches in a photograph, [N, 2] px.
        reference_places: their places in the reference, [N, 2] px.
        max_error_px: how far off a match may be that fits.

    Returns:
        The homography, [3, 3], and which matches fit it, [N].
    """
    homography, is_inlier = np.eye(3), None
    if len(places) >= MIN_MATCHES:
        homography, is_inlier = import_opencv().findHomography(
            places, reference_places, import_opencv().USAC_MAGSAC, max_error_px, None, 20_000, 0.9999
        )
    return (
        (homography, is_inlier[:, 0] > 0)
        if is_inlier is not None and homography is not None
        else (np.eye(3), np.zeros(len(places), bool))
    )


def apply_homography(homography: Floats, points: Floats) -> Floats:
    """Return points [N, 2] moved by a homography [3, 3]."""
    homogeneous_points = np.pad(points, ((0, 0), (0, 1)), constant_values=1.0) @ homography.T
    return np.asarray(homogeneous_points[:, :2] / homogeneous_points[:, 2:], np.float64)
