"""`metapp data lights`: directions to lamps by the highlights on glossy balls, within degrees of the truth."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from data_tools.readers.ball_places import mask_of_balls, write_ball_places
from data_tools.readers.light_directions import read_lights
from data_tools.readers.rti_photos import read_task
from metapp.extensions.capture.ball.ball_geometry import Ball, PinholeLens
from metapp.extensions.capture.lights.ball_search import find_lit_balls
from metapp.extensions.capture.lights.highlights import measure_highlights
from metapp.extensions.capture.lights.lamps import (
    MAX_UNKNOWN_LEAN_DEGREES,
    join_balls,
    place_of_ball,
    unknown_lean_degrees,
)
from metapp.extensions.capture.lights.lit_photos import measure_lights
from metapp.extensions.capture.lights.shading import find_contradictions
from tests.cli.messages import says
from tests.extensions.capture.lit_balls import Scene, angles_between, dome
from tests.pictures import noise_image, write_image

MAX_ERROR_DEGREES = {50: 1.0, 20: 2.5}  # by the radius of the ball in px
LAMPS = dome(9, 32.0)  # so high that all of a wide lamp is above the plane


def scene_around(radius: int, **changes: float) -> Scene:
    side = int(2.8 * radius)
    return Scene([(side / 2 + 0.3, side / 2 - 0.2, radius)], side, side)._replace(**changes)


def photograph(scene: Scene, lamps: np.ndarray) -> np.ndarray:
    return np.stack([scene.photograph(lamp, seed).mean(0) for seed, lamp in enumerate(lamps)])


@pytest.mark.parametrize("radius", [20, 50])
@pytest.mark.parametrize(
    "changes",
    [
        {},  # a lamp as small as a point
        {"noise": 0.02},
        {"lamp_degrees": 29.0, "radiance": 5.0},  # a quarter of the ball, not clipped
        {"lamp_degrees": 29.0, "radiance": 60.0},  # and clipped
        {"window": 60.0},  # a constant reflection that clips
        {"body": 0.3},  # a grey ball
    ],
)
def test_highlights_of_any_size_tell_the_direction(radius: int, changes: dict[str, float]) -> None:
    point = {"lamp_degrees": 60 / radius, "radiance": 8 * radius}  # whose highlight is a pixel wide
    scene = scene_around(radius, **(changes or point))
    highlights = measure_highlights(photograph(scene, LAMPS), Ball(*scene.balls[0]))
    assert [highlight.fault for highlight in highlights] == [""] * len(LAMPS)
    errors = angles_between(np.stack([highlight.direction for highlight in highlights]), LAMPS)
    assert errors.max() < MAX_ERROR_DEGREES[radius]


@pytest.mark.parametrize("radius", [20, 50])
def test_a_ball_stated_roughly_is_corrected_by_its_rim(tmp_path: Path, radius: int) -> None:
    scene = scene_around(radius)
    x, y, _ = scene.balls[0]
    paths = scene.write(tmp_path, LAMPS)
    lights = measure_lights(paths, [(x + 0.03 * radius, y - 0.02 * radius, 0.97 * radius)])
    assert lights.balls[0].ball[:3] == pytest.approx(scene.balls[0], abs=0.015 * radius)
    assert angles_between(lights.lamps.directions, LAMPS).max() < MAX_ERROR_DEGREES[radius]


@pytest.mark.long
@pytest.mark.parametrize("count", [1, 2])
def test_balls_are_found_by_all_photographs(count: int) -> None:
    scene = Scene([(30, 100, 20), (165, 35, 22)][:count])
    found = find_lit_balls(photograph(scene, LAMPS), Ball(0, 0, 1).lens)
    assert len(found) == count
    for lit_ball in found:
        distances = [np.abs(np.subtract(lit_ball.ball[:3], ball)).max() for ball in scene.balls]
        assert min(distances) < 2


def test_no_ball_is_found_where_there_is_none() -> None:
    assert find_lit_balls(photograph(Scene([], 120, 90), LAMPS), Ball(0, 0, 1).lens) == []


def test_photographs_without_one_highlight_are_named(tmp_path: Path) -> None:
    scene, lamps = scene_around(20), LAMPS.copy()
    lamps[3] = 0
    paths = scene.write(tmp_path, lamps)
    both = np.maximum(scene.photograph(LAMPS[1]), scene.photograph(LAMPS[4]))
    write_image(paths[6], (255 * both.transpose(1, 2, 0) ** (1 / 2.2)).round().astype(np.uint8))
    lights = measure_lights(paths, scene.balls)
    assert sorted(lights.faults) == [3, 6]
    assert "no highlight" in lights.faults[3]
    assert "2 highlights of similar strength" in lights.faults[6]
    assert np.isnan(lights.lamps.directions).all(1).nonzero()[0].tolist() == [3, 6]


@pytest.mark.parametrize("distance", [1.5, 4.0, np.inf])
def test_two_balls_tell_how_far_lamps_are(distance: float) -> None:
    balls, shape = [Ball(200, 900, 80), Ball(1400, 300, 80)], (1000, 1500)
    rng = np.random.default_rng(0)
    directions = np.stack([LAMPS - place_of_ball(ball, shape) / distance for ball in balls])
    directions += 0.005 * rng.standard_normal(directions.shape)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    directions[0, 2] = np.nan  # hidden from one ball
    lamps = join_balls(directions, balls, shape)
    assert angles_between(lamps.directions, LAMPS).max() < 1
    assert lamps.distance == pytest.approx(distance, rel=0.1)
    assert (lamps.parallax_degrees > lamps.noise_degrees) == np.isfinite(distance)


@pytest.mark.parametrize(
    ("balls", "is_doubted"),
    [
        ([Ball(30, 30, 20)], True),
        ([Ball(110, 70, 20)], False),  # in the middle
        ([Ball(30, 30, 20), Ball(172, 112, 20)], False),  # on both sides of it
        ([Ball(30, 30, 20, PinholeLens(300, 100, 70))], False),  # by a known lens
    ],
)
def test_directions_by_an_unknown_lens_are_doubted_off_the_middle(balls: list[Ball], is_doubted: bool) -> None:
    assert (unknown_lean_degrees(balls, (140, 200)) > MAX_UNKNOWN_LEAN_DEGREES) == is_doubted


@pytest.mark.parametrize(("slope", "is_told"), [(0.5, True), (0.0, False)])
def test_directions_that_shading_contradicts_are_found(slope: float, is_told: bool) -> None:
    """Relief tells a wrong direction, a flat surface does not; right directions are never contradicted."""
    rng, lamps = np.random.default_rng(0), dome(14)
    normals = np.concatenate([slope * rng.standard_normal((300, 2)), np.ones((300, 1))], 1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    pictures = (lamps @ normals.T).clip(0) * rng.uniform(0.2, 0.8, 300) + 0.01 * rng.standard_normal((14, 300))
    assert find_contradictions(pictures, lamps) == {}
    wrong = lamps.copy()
    wrong[5] = lamps[5] * [-1, -1, 1]
    contradicted = find_contradictions(pictures, wrong)
    assert list(contradicted) == [5] * is_told
    if is_told:
        assert contradicted[5] == pytest.approx(angles_between(wrong[5:6], lamps[5:6])[0], abs=15)


@pytest.fixture
def coin(tmp_path: Path) -> Path:
    """Photographs of a ball, one of them with the lamp hidden, in a folder `coin`."""
    scene = Scene([(25, 25, 20)], 100, 60)
    scene.write(tmp_path / "coin", np.concatenate([LAMPS, np.zeros((1, 3))]))
    return tmp_path / "coin"


def test_the_command_writes_a_text_that_is_read(metapp: Callable, coin: Path) -> None:
    words = ["data", "lights", coin, "--ball", "25,25,20", "--out", coin / "coin.lp"]
    result = metapp(*words, "--json")
    assert says(result.err, "09.png", "no highlight", "expected one"), result.err
    assert says(result.err, "coin.lp", "9 of 10 photos")
    assert says(result.err, "field of view unknown", "--fov")
    paths, directions, _ = read_lights(coin / "coin.lp")
    assert [path.name for path in paths] == [f"{number:02}.png" for number in range(len(LAMPS))]
    assert angles_between(directions.numpy(), LAMPS).max() < MAX_ERROR_DEGREES[20]
    output = result.json_result
    assert [photo["name"] for photo in output["photos"]] == [path.name for path in paths]
    assert [Path(photo["source"]).name for photo in output["left_out"]] == ["09.png"]
    assert (coin / "found/coin.png").is_file()
    mask = mask_of_balls(coin / "coin.lp", 60, 100)
    assert mask.sum() == pytest.approx(np.pi * 20**2, rel=0.05)
    np.testing.assert_allclose(np.argwhere(mask).mean(0) + 0.5, [25, 25], atol=0.5)
    assert says(metapp(*words).misuse, "coin.lp", "--overwrite")
    again = metapp(*words, "--overwrite")  # neither the texts nor the picture count as photographs
    assert says(again.err, "9 of 10 photos")
    assert "skipped" not in again.err


def test_a_dome_takes_the_names_of_photographs_without_the_ball(metapp: Callable, coin: Path, tmp_path: Path) -> None:
    words = ["data", "lights", coin, "--ball", "25,25,20", "--names", "vase", "--out", "vase/vase.lp"]
    for number in range(9):
        write_image(tmp_path / f"vase/IMG {number}.png", noise_image(60, 100, seed=number))
    assert says(metapp(*words).error, "vase", "9 photos", "expected 10")
    write_image(tmp_path / "vase/IMG 9.png", noise_image(60, 100, seed=9))
    metapp(*words, "--quiet")
    assert [path.name for path in read_lights(tmp_path / "vase/vase.lp").photos] == [
        f"IMG {number}.png" for number in range(9)
    ]
    assert not mask_of_balls(tmp_path / "vase/vase.lp", 60, 100).any()


@pytest.mark.parametrize(
    ("words", "facts"),
    [
        (["--ball", "1,2"], ("--ball", "expected centre and radius")),
        (["--ball", "1,2,3", "--ball", "4,5,6", "--ball", "7,8,9"], ("--ball", "3 balls", "one or two")),
        (["--ball", "900,25,20"], ("900,25", "100x60 px", "--ball")),
    ],
)
def test_bad_balls_are_a_line(metapp: Callable, coin: Path, words: list[str], facts: tuple[str]) -> None:
    result = metapp("data", "lights", coin, *words, "--out", "coin.lp")
    assert says(result.error if result.code == 1 else result.misuse, *facts)
    assert not Path("coin.lp").exists()


def test_other_faults_are_a_line(metapp: Callable, coin: Path, tmp_path: Path) -> None:
    options = ["--ball", "25,25,20", "--out", "coin.lp"]
    assert says(metapp("data", "lights", coin / "00.png", *options).error, "1 photo", "expected 3")
    write_image(tmp_path / "other/00.png", noise_image(60, 100, seed=0))
    assert says(metapp("data", "lights", coin, "other", *options).error, "00.png", "several photos")
    write_image(tmp_path / "other/00.png", noise_image(60, 90, seed=0))
    Path("other/00.png").rename("other/x.png")
    assert says(metapp("data", "lights", coin, "other", *options).error, "x.png", "90 x 60 px", "100 x 60 px")
    for photo in coin.glob("*.png"):
        write_image(photo, noise_image(60, 100, seed=int(photo.stem)))
    assert says(metapp("data", "lights", coin, "--out", "coin.lp").error, "no glossy ball", "--ball")


@pytest.mark.parametrize(("place", "is_said"), [((50, 30, 10), True), ((-20, 30, 8), False)])
def test_a_ball_in_the_photographs_is_left_out(
    tmp_path: Path, recwarn: pytest.WarningsRecorder, place: tuple[float, ...], is_said: bool
) -> None:
    for number in range(3):
        write_image(tmp_path / f"{number}.png", noise_image(60, 100, seed=number))
    (tmp_path / "coin.lp").write_text("3\n" + "".join(f"{number}.png {number - 1} 0 1\n" for number in range(3)))
    write_ball_places(tmp_path / "coin.lp", [place], 60, 100)
    photos = read_task(tmp_path, 64).data["lit"]
    assert any(says(str(warning.message), "ball covers", "left out") for warning in recwarn) == is_said
    assert bool((photos[:, :, 18, 32] == 0).all()) == is_said
    assert bool(photos[:, :, 2, 2].any())


@pytest.mark.parametrize("text", ["", "100\n", "100 60\n5 5\n", "100 60\n5 5 nan\n", "100 60\na b c\n", "0 0\n1 1 1\n"])
def test_damaged_places_of_balls_are_a_line(tmp_path: Path, text: str) -> None:
    (tmp_path / "coin.balls").write_text(text)
    with pytest.raises(ValueError, match=r"coin\.balls: .*expected.*; write it again\."):
        mask_of_balls(tmp_path / "coin.lp", 60, 100)
