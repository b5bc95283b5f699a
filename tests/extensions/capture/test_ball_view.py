"""The geometry of a mirror ball: reflection, its inverse, and the contour of its cone."""

import math

import numpy as np
import pytest

from metapp.extensions.capture.ball.ball_geometry import (
    FAR_CAMERA_ANGLE_RAD,
    Ball,
    PinholeLens,
    directions_to_disc,
    disc_to_directions,
)

ANGLES = (FAR_CAMERA_ANGLE_RAD, 0.02, 0.3, 1.0)


@pytest.mark.parametrize("angle", ANGLES)
def test_a_direction_is_seen_where_it_is_mirrored(angle: float) -> None:
    towards = np.random.default_rng(0).normal(size=(3, 2000))
    towards /= np.linalg.norm(towards, axis=0)
    place, speed = directions_to_disc(towards, angle)
    shown = towards[2] > math.cos(math.pi - angle)
    assert (speed[~shown] == 0).all()
    np.testing.assert_allclose(disc_to_directions(place, angle)[:, speed > 1e-3], towards[:, speed > 1e-3], atol=1e-9)
    further, _ = directions_to_disc(np.array([[math.sin(0.5 + 1e-6)], [0], [math.cos(0.5 + 1e-6)]]), angle)
    position, pace = directions_to_disc(np.array([[math.sin(0.5)], [0], [math.cos(0.5)]]), angle)
    np.testing.assert_allclose((further - position)[0] / 1e-6, pace, rtol=1e-4)


@pytest.mark.parametrize("angle", ANGLES[1:])
def test_rays_are_mirrored_by_the_ball_that_they_meet(angle: float) -> None:
    """Against the intersection of rays with a sphere."""
    disc = np.random.default_rng(1).uniform(-0.7, 0.7, (2, 500))
    away = 1 / math.sin(angle)
    ray = np.stack([*(disc * math.tan(angle)), -np.ones(500)])
    ray /= np.linalg.norm(ray, axis=0)
    along = -ray[2] * away
    normal = (along - np.sqrt(along**2 - away**2 + 1)) * ray + np.array([[0], [0], [away]])
    np.testing.assert_allclose(disc_to_directions(disc, angle), ray - 2 * (ray * normal).sum(0) * normal, atol=1e-10)


def test_from_far_away_a_near_camera_is_an_orthographic_one() -> None:
    disc = np.random.default_rng(2).uniform(-0.7, 0.7, (2, 100))
    np.testing.assert_allclose(disc_to_directions(disc, 1e-5), disc_to_directions(disc), atol=1e-4)
    np.testing.assert_allclose(disc_to_directions(np.zeros((2, 1)), 0.3), [[0], [0], [1]])


def test_a_contour_is_the_edge_of_a_cone() -> None:
    ball = Ball(300, 200, 80, lens=PinholeLens(500, 256, 250))
    turn = np.linspace(0, 6, 50)
    px = ball.to_px(np.stack([np.cos(turn), np.sin(turn)]))
    rays = np.stack([px[0] - 256, px[1] - 250, np.full(50, 500.0)])
    centre = np.array([300 - 256, 200 - 250, 500])
    cosines = centre @ rays / np.linalg.norm(rays, axis=0) / np.linalg.norm(centre)
    np.testing.assert_allclose(np.arccos(cosines), ball.half_angle_rad, atol=1e-9)
    up, right = ball.to_px(np.array([0, 1.0])), ball.to_px(np.array([1.0, 0]))
    assert up[1] < 200
    assert right[0] > 300
    place = np.array([0.3, 0.4])
    np.testing.assert_allclose(ball.resize(0.5).to_px(place), ball.to_px(place) / 2)
