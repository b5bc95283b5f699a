"""Environment maps of hand-held and bracketed photographs of a ball: registration, exposures, response curves."""

from pathlib import Path

import numpy as np
import pytest
import torch

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.latlong import texel_directions
from metapp.extensions.capture.ball.ball_geometry import Ball, disc_places, disc_to_directions
from metapp.extensions.capture.ball.bracket import (
    align_balls,
    exif_exposure,
    fit_curve_power,
    merge_exposures,
    pair_by_brightness,
    read_exposures,
)
from metapp.extensions.capture.ball.capture import capture_light
from tests.extensions.capture.ball_photos import (
    background_of_boxes,
    detailed_light,
    photograph_ball,
    pixels_of_linear,
    write_linear_png,
)

TIMES = (1 / 20, 1 / 60, 1 / 240)
SHUTTER = "1/20,1/60,1/240"


def test_hand_held_photographs_are_aligned() -> None:
    ball = Ball(150, 140, 100)
    known = pixels_of_linear(photograph_ball(ball, 280, 300, 0.1, detailed_light))
    true = Ball(157, 135, 98)
    other = pixels_of_linear(0.4 * photograph_ball(true, 280, 300, 0.1, detailed_light))
    _, found = align_balls([known, other], [ball, ball], [0, 1], 0)
    np.testing.assert_allclose(found[:3], true[:3], atol=0.3)


def lamp_lit(towards: np.ndarray) -> np.ndarray:
    return detailed_light(towards) * 0.6 + 20 * np.exp(60 * (towards[1] * 0.8 + towards[2] * 0.6 - 1))


@pytest.fixture(scope="module")
def brackets(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A ball under a lamp by hand, linear but for sRGB's curve."""
    folder = tmp_path_factory.mktemp("brackets")
    paths = []
    for number, time in enumerate(TIMES):
        ball = Ball(80 + 2 * number, 75 - 2 * number, 60)
        picture = time / TIMES[0] * photograph_ball(ball, 150, 160, 0.02, lamp_lit)
        paths.append(write_linear_png(folder / f"{number}.png", picture))
    return paths


def test_brackets_have_the_radiance_of_the_scene(brackets: list[Path]) -> None:
    found = capture_light(brackets, SHUTTER, circle=(80, 75, 60))
    np.testing.assert_allclose(found.exposures / found.exposures[0], np.array(TIMES) / TIMES[0])
    true = torch.from_numpy(lamp_lit(texel_directions(64, 128, dtype=torch.float64).numpy())).float()
    certain = (found.data["certain"][0] > 0.99) & (true.amin(0) > 0.05)
    ratios = found.data["seen"] / true
    ratios = ratios / ratios[:, certain].median()
    assert ratios[:, certain].log().abs().quantile(0.9) < 0.1
    lamp = certain & (true.amax(0) > 3)
    assert lamp.sum() > 20
    assert 0.9 < ratios[:, lamp].median() < 1.1
    assert found.data["photos"].shape == (1, 3, 64, 64)


def test_a_foreign_curve_is_recovered() -> None:
    values = detailed_light(disc_to_directions(disc_places(160)))
    inside_disc = np.hypot(*disc_places(160)) < 1
    times = np.array(TIMES) / TIMES[0]
    lights = [np.clip(values * time, 0, 1) ** 1.5 for time in times]
    lights = [np.round(linear_to_srgb(torch.from_numpy(light)).numpy() * 255) / 255 for light in lights]
    lights = [srgb_to_linear(torch.from_numpy(light)).numpy() for light in lights]
    pictures = np.stack([[*light, inside_disc] for light in lights])
    radiance, _, residuals = merge_exposures(pictures, times, fit_curve_power(pictures, times))
    assert max(residuals) < 0.05
    assert max(merge_exposures(pictures, times, 1.0)[2]) > 0.15
    bright = inside_disc & (values.min(0) > 0.1) & (values.max(0) < 0.9)
    ratios = radiance[:, bright] / values[:, bright]
    assert np.abs(np.log(ratios / np.median(ratios))).mean() < 0.1


def test_pixels_that_clip_in_all_photographs_are_lower_bounds() -> None:
    values = np.linspace(0.0, 4, 10000).reshape(1, 100, 100).repeat(3, 0)
    pictures = np.stack([[*np.clip(values * time, 0, 1), np.ones((100, 100))] for time in (1.0, 0.5)])
    radiance, is_clipped, _ = merge_exposures(pictures, np.array([1.0, 0.5]), 1.0)
    assert (is_clipped == (values[0] * 0.5 >= ((0.98 + 0.055) / 1.055) ** 2.4)).all()
    inside = ~is_clipped & (values[0] > 0.01)
    np.testing.assert_allclose(radiance[:, inside], values[:, inside], rtol=1e-5)
    assert (radiance[:, is_clipped] <= values[:, is_clipped] + 1e-9).all()


def test_exposures_are_read() -> None:
    paths = [Path(name) for name in "abc"]
    assert read_exposures(paths, "1/20, 0.5,2").tolist() == [0.05, 0.5, 2]
    assert read_exposures(paths[:1], "auto").tolist() == [1]
    for text in ("", "1/0", "a", "1,-2", "1/20/3", "1e308", "1,1e-320"):
        with pytest.raises(ValueError, match="expected exposure times"):
            read_exposures(paths, text)


def test_exposures_are_read_from_exif(tmp_path: Path) -> None:
    from PIL import Image
    from PIL.TiffImagePlugin import IFDRational

    path = tmp_path / "a.jpg"
    exif = Image.Exif()
    exif[0x8769] = {0x829A: IFDRational(1, 20), 0x829D: IFDRational(2, 1), 0x8827: 400}
    Image.new("RGB", (40, 40)).save(path, exif=exif)
    assert exif_exposure(path) == pytest.approx(0.05 * 4 / 4)
    Image.new("RGB", (40, 40)).save(path)
    assert exif_exposure(path) == 0


def test_photographs_without_a_ball_are_refused_in_one_line(tmp_path: Path) -> None:
    path = write_linear_png(tmp_path / "a.png", background_of_boxes(200, 240, 0)[None].repeat(3, 0))
    with pytest.raises(ValueError, match=r"a\.png: no ball found .* say where it is with --ball"):
        capture_light([path])
    found = capture_light([path], circle=(120, 100, 60))
    assert tuple(found.balls[0][:3]) == pytest.approx((120, 100, 60))


@pytest.mark.parametrize(
    ("shutter", "line"),
    [
        ("1,2", r"exposures: 2 for 3 photos, expected"),
        ("20,60,240", r"exposures: photos get darker as times get longer, expected times such as 1/60"),
        ("auto", r"0\.png: no exposure time in its EXIF, expected different ones; give them: --shutter"),
    ],
)
def test_impossible_exposures_are_refused_in_one_line(brackets: list[Path], shutter: str, line: str) -> None:
    with pytest.raises(ValueError, match=line):
        capture_light(brackets, shutter, circle=(80, 75, 60))


def test_shutter_times_in_another_order_go_by_brightness() -> None:
    paths = [Path(name) for name in ("a-10.jpg", "a-160.jpg", "a-40.jpg")]
    stated = np.array([1 / 10, 1 / 40, 1 / 160])
    with pytest.warns(UserWarning, match=r"a-10\.jpg 0\.1 s, a-160\.jpg 0\.00625 s, a-40\.jpg 0\.025 s"):
        paired = pair_by_brightness(stated, [0.8, 0.2, 0.4], paths)
    assert paired.tolist() == [1 / 10, 1 / 160, 1 / 40]
    assert pair_by_brightness(stated, [0.8, 0.4, 0.2], paths).tolist() == stated.tolist()
    assert pair_by_brightness(stated, [0.2, 0.4, 0.8], paths).tolist() == stated.tolist()  # reversed: refused elsewhere
