"""The environment map that is unwrapped from one photograph of a mirror ball: its values, clipping and uncertainty."""

import math

import numpy as np
import pytest
import torch

from data_tools.readers.image_files import Pixels
from data_tools.readers.lenses import ExifLens
from metapp.appearance.latlong import texel_directions
from metapp.extensions.capture.ball.ball_geometry import (
    FAR_CAMERA_ANGLE_RAD,
    PARALLEL_LENS,
    Ball,
    PinholeLens,
    disc_places,
    disc_to_directions,
)
from metapp.extensions.capture.ball.ball_picture import lens_of_photo
from metapp.extensions.capture.ball.capture import unwrap_ball
from tests.extensions.capture.ball_photos import smooth_light


@pytest.mark.parametrize("angle", [FAR_CAMERA_ANGLE_RAD, 0.1, 0.4])
def test_the_map_is_what_the_ball_mirrors(angle: float) -> None:
    places = disc_places(400)
    ball = Ball(0, 0, 200, PinholeLens(200 / math.tan(angle), 0, 0))
    values = smooth_light(disc_to_directions(places, angle))
    seen, certain = unwrap_ball(values, np.zeros((400, 400), bool), np.ones((400, 400)), ball, 64)
    true = torch.from_numpy(smooth_light(texel_directions(64, 128, dtype=torch.float64).numpy())).float()
    error = (seen - true).abs()
    assert error[:, certain[0] > 0.99].max() < 0.01
    assert error[:, certain[0] > 0].max() < 0.03
    assert (certain[1] == 0).all()
    hidden = texel_directions(64, 128)[2] < -math.cos(max(0.0, angle - 0.05))
    assert (certain[0][hidden] == 0).all()
    assert (certain[0] > 0.99).float().mean() > 0.8


def test_clipping_is_reported_and_small_balls_are_less_certain() -> None:
    places = disc_places(200)
    values = smooth_light(disc_to_directions(places))
    clipped = values.max(0) > 0.75
    _, certain = unwrap_ball(values, clipped, np.ones((200, 200)), Ball(0, 0, 100), 64)
    bright = torch.from_numpy(smooth_light(texel_directions(64, 128, dtype=torch.float64).numpy())).max(0).values
    assert (certain[1][bright > 0.78] > 0.9).all()
    assert (certain[1][bright < 0.72] == 0).all()
    assert (certain.sum(0) <= 1.00001).all()
    _, small = unwrap_ball(values, clipped, np.ones((200, 200)), Ball(0, 0, 20), 64)
    assert (small.sum(0) <= certain.sum(0) + 1e-6).all()


def test_a_cropped_photograph_has_no_lens() -> None:
    whole = Pixels(np.zeros((1500, 2000, 3), np.uint8), "", False, ExifLens(26.0))
    lens = lens_of_photo(whole, 0.0)
    assert lens.focal == pytest.approx(26 * 2500 / math.hypot(36, 24))
    assert lens_of_photo(whole._replace(values=whole.values[:, :1700]), 0.0) == PARALLEL_LENS
    larger = whole._replace(lens=ExifLens(26.0, whole_px=(3000, 2500)))  # of which 2000 x 1500 px are a part
    with pytest.warns(UserWarning, match=r"IMG_1.jpg: EXIF is of .*2,000 x 1,500 px are a part.*far away; --fov"):
        assert lens_of_photo(larger, 0.0, "IMG_1.jpg") == PARALLEL_LENS
    assert lens_of_photo(whole._replace(lens=ExifLens(26.0, whole_px=(4000, 3000))), 0.0) == lens
    given = lens_of_photo(whole._replace(values=whole.values[:, :1700]), math.pi / 2)
    assert given == pytest.approx(PinholeLens(750, 850, 750))
