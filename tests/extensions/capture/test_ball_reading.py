"""Photographs of balls as inputs of fits: old ones stay as they are, a mirror says what it shows."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import torch

from data_tools.readers import environment_maps
from data_tools.readers.square_photos import read_photo
from metapp.appearance.latlong import sphere_normals, texel_directions
from metapp.extensions.capture.ball.ball_geometry import Ball
from metapp.extensions.capture.ball.ball_picture import is_mirror_ball, mirror_features
from metapp.extensions.capture.ball.ball_reader import read_task
from metapp.extensions.capture.ball.capture import capture_light
from tests.extensions.capture.ball_photos import (
    detailed_light,
    photograph_ball,
    pixels_of_linear,
    smooth_light,
    write_linear_png,
)
from tests.pictures import write_image


def room(towards: np.ndarray) -> np.ndarray:
    """Return an environment map with edges and dark parts, by which a mirror ball is recognised."""
    boxes = np.sign(np.sin(14 * towards[0])) * np.sign(np.sin(11 * towards[1])) * np.sign(np.sin(9 * towards[2] + 1))
    return detailed_light(towards) * np.where(boxes > 0, 1.0, 0.08)


def matte() -> np.ndarray:
    """A square photograph of a matte ball that touches the borders."""
    normals, mask = sphere_normals(160, dtype=torch.float64)
    return ((0.3 + 0.25 * normals[:1] + 0.3 * normals[1:2]).clamp_min(0.02) * mask).repeat(3, 1, 1).numpy()


def noise(size: int = 64) -> np.ndarray:
    """A picture that is bright all over, uint8 [size, size, 3]."""
    return np.random.default_rng(0).integers(60, 256, (size, size, 3), dtype=np.uint8)


def square(path: Path) -> torch.Tensor:
    """The central square of a photograph, [1, 3, 64, 64], black outside its disc."""
    return (read_photo(path, 64) * sphere_normals(64)[1])[None]


def test_a_ball_that_touches_the_borders_is_read_as_ever(tmp_path: Path) -> None:
    path = write_linear_png(tmp_path / "matte.png", matte())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = read_task(path).data
    assert read.keys() == {"photos"}
    assert torch.equal(read["photos"], square(path))


def test_a_photograph_without_a_ball_says_so(tmp_path: Path) -> None:
    path = write_linear_png(tmp_path / "wall.png", np.moveaxis(noise(160) / 255, 2, 0))
    with pytest.warns(UserWarning, match="wall.png: no ball found .* the disc in the middle is taken for one"):
        read_task(path)


def test_a_matte_ball_elsewhere_is_cropped_to_it(tmp_path: Path) -> None:
    picture = np.full((3, 240, 320), 0.6)
    mask = sphere_normals(160)[1].numpy()
    picture[:, 60:220, 130:290] = np.where(mask, matte(), 0.6)
    read = read_task(write_linear_png(tmp_path / "matte.png", picture)).data
    assert read.keys() == {"photos"}
    other = square(write_linear_png(tmp_path / "cropped.png", matte()))
    inside = sphere_normals(64)[1] & (torch.from_numpy(np.hypot(*np.mgrid[-31.5:32, -31.5:32])) < 30)
    assert (read["photos"].float() - other.float()).abs()[..., inside].mean() < 3


def test_mirror_balls_are_read_as_the_map_they_mirror(tmp_path: Path) -> None:
    ball = Ball(150, 120, 80)
    read = read_task(write_linear_png(tmp_path / "mirror.png", photograph_ball(ball, 220, 300, 0.9, room)), 32).data
    assert read["seen"].shape == (3, 32, 64)
    assert read["certain"].shape == (2, 32, 64)
    true = torch.from_numpy(room(texel_directions(32, 64, dtype=torch.float64).numpy())).float()
    certain = read["certain"][0] > 0.99
    assert certain.float().mean() > 0.7
    assert (read["seen"] - true)[:, certain].abs().median() < 0.03


def lamp_lit(towards: np.ndarray) -> np.ndarray:
    """Return an environment map with a lamp that is far brighter than white."""
    return room(towards) + 400 * (towards[1] * 0.8 + towards[2] * 0.6 > 0.95)


@pytest.mark.parametrize("alpha", [False, True])
def test_a_linear_photograph_keeps_its_radiance(tmp_path: Path, alpha: bool) -> None:
    picture = photograph_ball(Ball(150, 120, 80), 220, 300, 0.9, lamp_lit).transpose(1, 2, 0).astype(np.float32)
    picture = np.concatenate([picture, np.ones((220, 300, 1), np.float32)], -1) if alpha else picture
    path = write_image(tmp_path / "mirror.exr", picture)
    read = environment_maps.read_task(path, 32, observe="photo").data
    true = torch.from_numpy(lamp_lit(texel_directions(32, 64, dtype=torch.float64).numpy())).float()
    seen = read["certain"][0] > 0.5
    assert read["certain"][1].max() == 0  # nothing clips
    assert 0.9 < (read["seen"] * seen).sum() / (true * seen).sum() < 1.1
    found = capture_light([path], rows=32).data
    assert 0.9 < (found["seen"] * seen).sum() / (true * seen).sum() < 1.1
    assert found["certain"][1].max() == 0
    with pytest.raises(ValueError, match=r"300x220 px, expected a lat-long map, .*is for fits with --observe photo"):
        environment_maps.read_task(path, 32, observe="reference")
    picture[5, 5] = np.inf
    with pytest.raises(ValueError, match=r"mirror\.exr: .* values are NaN or infinite, expected finite ones"):
        capture_light([write_image(path, picture)])


@pytest.mark.parametrize("lit", [smooth_light, detailed_light])
def test_balls_that_may_be_matte_are_not_taken_for_mirrors(lit: object) -> None:
    assert not is_mirror_ball(pixels_of_linear(matte()), Ball(80, 80, 80))
    smooth = pixels_of_linear(photograph_ball(Ball(80, 80, 78), 160, 160, 0.05, smooth_light))
    assert not is_mirror_ball(smooth, Ball(80, 80, 78))


def test_small_balls_are_not_classified() -> None:
    sharp = pixels_of_linear(photograph_ball(Ball(80, 80, 78), 160, 160, 0.05, room))
    assert is_mirror_ball(sharp, Ball(80, 80, 78))
    assert not is_mirror_ball(sharp, Ball(80, 80, 30))
    assert np.isfinite(mirror_features(np.zeros((3, 128, 128)))).all()


def test_photographs_without_a_ball_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"a.png: 128x64 px of uint8, expected an HDR map .* or a photograph"):
        read_task(write_image(tmp_path / "a.png", noise(128)[:64], "uint8"))
    values = noise()
    values[sphere_normals(64)[1].numpy()] = 0
    with pytest.raises(ValueError, match=r"a.png: black inside the disc"):
        read_task(write_image(tmp_path / "a.png", values, "uint8"))
