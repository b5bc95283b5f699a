"""Finding balls: on drawn photographs, where noise, blur, borders and backgrounds are in the way."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from metapp.extensions.capture.ball.ball_geometry import Ball, PinholeLens
from metapp.extensions.capture.ball.circle import MIN_BALL_SCORE, find_ball
from tests.extensions.capture.ball_photos import background_of_boxes, detailed_light, photograph_ball


def gray(linear: np.ndarray) -> np.ndarray:
    return linear.mean(0).clip(0, 1) ** (1 / 2.2)


@pytest.mark.parametrize(
    ("circle", "noise", "blur", "tolerance"),
    [
        ((150.3, 120.6, 80.2), 0.0, 0.0, 0.5),
        ((150.3, 120.6, 80.2), 0.05, 1.0, 0.5),
        ((101.7, 168.4, 60.9), 0.02, 2.0, 2.0),  # out of focus
        ((160.0, 112.0, 125.0), 0.02, 0.0, 1.0),  # cut by two borders
        ((30.0, 110.0, 70.0), 0.02, 0.0, 1.0),  # by one
    ],
)
def test_a_ball_is_found_before_a_busy_background(
    circle: tuple[float, float, float], noise: float, blur: float, tolerance: float
) -> None:
    picture = photograph_ball(Ball(*circle), 240, 300, background_of_boxes(240, 300, 3), detailed_light)
    picture = gaussian_filter(gray(picture), blur) + noise * np.random.default_rng(0).normal(size=(240, 300))
    found = find_ball(picture.clip(0, 1))
    assert found is not None
    assert found.score > MIN_BALL_SCORE
    np.testing.assert_allclose(found[:3], circle, atol=tolerance)


def test_with_a_lens_the_contour_is_an_ellipse() -> None:
    lens = PinholeLens(240, 150, 120)
    ball = Ball(215, 150, 45, lens=lens)
    found = find_ball(gray(photograph_ball(ball, 240, 300, background_of_boxes(240, 300, 1), detailed_light)), lens)
    assert found is not None
    np.testing.assert_allclose(found[:3], ball[:3], atol=0.4)


@pytest.mark.parametrize("seed", range(4))
def test_where_there_is_no_ball_none_is_found(seed: int) -> None:
    found = find_ball(background_of_boxes(200, 260, seed) ** (1 / 2.2))
    assert found is None or found.score < MIN_BALL_SCORE


def test_a_picture_without_edges_has_no_ball() -> None:
    assert find_ball(np.full((100, 120), 0.4)) is None
