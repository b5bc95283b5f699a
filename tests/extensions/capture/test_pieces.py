"""Pieces of pictures that are found again: places to parts of a px, and nothing where pictures are unrelated."""

import numpy as np
import pytest

from tests.extensions.capture.marker_photos import cv2  # isort: skip

from metapp.extensions.capture.rectified.features import apply_homography
from metapp.extensions.capture.rectified.pieces import JUDGED_SIDE_PX, guess_by_pieces, match_pieces

SIZE = 480, 360  # width, height


def everywhere(places: np.ndarray) -> np.ndarray:
    return np.ones(len(places), bool)


def picture(seed: int, noise: float = 0.0, noise_seed: int = 9) -> np.ndarray:
    """Smooth random values [360, 480] of deviation 1 and, as large beside them as it says, noise of each px."""
    values = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, SIZE[::-1]), (0, 0), 4)
    values = values / values.std() + noise * np.random.default_rng(noise_seed).normal(0, 1, SIZE[::-1])
    return values.astype(np.float32)


def homography(scale: float, turn_degrees: float, tilt: float = 0.0) -> np.ndarray:
    middle = SIZE[0] / 2, SIZE[1] / 2
    turned = np.vstack([cv2.getRotationMatrix2D(middle, turn_degrees, scale), [0, 0, 1]])
    return turned @ np.array([[1, 0, 0], [0, 1, 0], [tilt / SIZE[0], 0, 1]])


@pytest.mark.parametrize("side_px", [JUDGED_SIDE_PX, 2 * JUDGED_SIDE_PX])
def test_places_are_found_to_parts_of_a_px(side_px: int) -> None:
    to_reference, photo = homography(1.03, 2.0, tilt=0.02), picture(1)
    reference = cv2.warpPerspective(photo, to_reference, SIZE, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    near = np.array([[1, 0, 3.0], [0, 1, -4.0], [0, 0, 1]]) @ to_reference
    found = match_pieces(photo, reference, everywhere, near, side_px)
    errors = np.linalg.norm(apply_homography(to_reference, found.places) - found.reference_places, axis=1)
    assert len(errors) > 100
    assert np.median(errors) < 0.15
    assert found.agreement < 0.1  # it is off by more than pieces may be
    assert match_pieces(photo, reference, everywhere, to_reference, side_px).agreement > 0.7


def test_pieces_are_found_beneath_noise_of_other_photographs_and_not_in_other_pictures() -> None:
    reference = picture(1, noise=3, noise_seed=1)
    agreements = [
        match_pieces(picture(seed, noise=3), reference, everywhere, np.eye(3), JUDGED_SIDE_PX).agreement
        for seed in (1, 2)
    ]
    assert agreements[0] > 0.7
    assert agreements[1] < 0.2


def test_only_the_part_that_counts_is_compared() -> None:
    def left(places: np.ndarray) -> np.ndarray:
        return places[:, 0] < 0.5

    found = match_pieces(picture(1), picture(1), left, np.eye(3), JUDGED_SIDE_PX)
    assert found.reference_places[:, 0].max() < SIZE[0] / 2
    assert found.agreement == 1


def test_a_homography_is_guessed_where_noise_hides_features() -> None:
    to_reference, photo = homography(1.2, -12.0, tilt=0.1), picture(1, noise=2)
    clean = cv2.warpPerspective(picture(1), to_reference, SIZE, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    reference = (
        clean + picture(2, noise=0) * 0.3 + np.random.default_rng(5).normal(0, 2, clean.shape).astype(np.float32)
    )
    guesses = list(guess_by_pieces(photo, reference, everywhere))
    inner = np.stack(np.meshgrid([160, 240, 320], [120, 180, 240]), -1).reshape(-1, 2).astype(np.float64)
    errors = np.linalg.norm(apply_homography(guesses[0], inner) - apply_homography(to_reference, inner), axis=1)
    assert errors.max() < 10
