"""`metapp data ball`: files that it writes, and its refusals."""

import math
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from data_tools.readers.image_files import read_pixels
from metapp.appearance.latlong import level_maps
from metapp.extensions.capture.ball.ball_geometry import Ball
from metapp.storage.shards import list_data_set_problems, read_data_set
from tests.extensions.capture.ball_photos import detailed_light, photograph_ball, write_linear_png


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    return write_linear_png(tmp_path / "a.png", photograph_ball(Ball(80, 75, 60), 150, 160, 0.02, detailed_light))


@pytest.fixture
def bracket(tmp_path: Path) -> list[Path]:
    picture = photograph_ball(Ball(80, 75, 60), 150, 160, 0.02, detailed_light)
    exposures = {"b": 0.5, "a": 1.0, "c": 2.0}
    return [write_linear_png(tmp_path / f"{name}.png", exposure * picture) for name, exposure in exposures.items()]


def test_data_set_map_and_detected_ball_are_written(metapp: Callable, bracket: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "garden"
    options = ["--shutter", "1/40,1/20,1/10", "--ball", "80,75,60", "--rows", "32"]
    result = metapp("data", "ball", *bracket, *options, "--out", out, "--json")
    output = result.json_result
    assert [photo["radius"] for photo in output["photos"]] == pytest.approx([60] * 3, abs=0.1)
    assert output["power"] == pytest.approx(1, abs=0.02)
    lines = result.err.splitlines()
    assert lines[0].startswith("b.png: ball at 80.0,75.0, radius 60.0 px, exposure 0.5, 0.")
    assert lines[3].startswith("camera's curve: sRGB's to the power of 1.00; ")
    assert list_data_set_problems(out) == []
    (task,) = read_data_set(out, "test", "illumination")
    assert task.name == "garden"
    assert task.data["photos"].shape == (1, 3, 64, 64)
    assert task.data["photos"].dtype == torch.uint8
    assert (task.data["photos"][..., 0, 0] == 0).all()
    assert task.data["seen"].shape == (3, 32, 64)
    assert task.data["certain"].shape == (2, 32, 64)
    assert float(task.data["certain"][0].mean()) == pytest.approx(output["seen"])
    assert (out / "garden.exr").is_file()
    assert sorted(file.name for file in (out / "found").glob("*.png")) == ["a.png", "b.png", "c.png"]


def test_a_ball_from_above_has_a_level_map(metapp: Callable, photo: Path, tmp_path: Path) -> None:
    ball = ["--ball", "80,75,60", "--rows", "32"]
    metapp("data", "ball", photo, *ball, "--out", tmp_path / "a", "-q")
    metapp("data", "ball", photo, *ball, "--pitch", 30, "--out", tmp_path / "b", "-q")
    (camera_task,), (level_task,) = (read_data_set(tmp_path / name, "test", "illumination") for name in "ab")
    torch.testing.assert_close(level_task.data, camera_task.data)  # what fits see is the photo's
    light, levelled = (
        torch.from_numpy(read_pixels(tmp_path / name / f"{name}.exr").values).permute(2, 0, 1) for name in "ab"
    )
    is_seen = (level_maps(light[3:], math.radians(30)) > 0.9)[0]
    expected = level_maps(light[:3], math.radians(30))[:, is_seen]
    torch.testing.assert_close(levelled[:3, is_seen], expected, atol=0.01, rtol=0.02)
    assert is_seen.float().mean() > 0.5


def test_fits_of_a_ball_from_above_write_a_level_map(metapp: Callable, photo: Path, tmp_path: Path) -> None:
    options = ["--recipe", "quick", "--json", "-q", "--out", tmp_path]
    fits = [
        metapp("general", "illumination", photo, *pitch, *options).json_result["tasks"][0]
        for pitch in ((), ("--pitch", 30))
    ]
    radiance, levelled = (
        torch.from_numpy(read_pixels(Path(fit["folder"]) / "map.exr").values).permute(2, 0, 1)[:3] for fit in fits
    )
    torch.testing.assert_close(levelled, level_maps(radiance, math.radians(30)), atol=1e-3, rtol=1e-2)
    assert not torch.allclose(levelled, radiance, rtol=0.1)


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--shutter", "a"], "expected exposure times"),
        (["--fov", "1e-300"], "--fov '1e-300': expected 0 or 0.5 to 150 degrees"),
        (["--ball", "1,2"], "expected centre and radius"),
    ],
)
def test_bad_options_are_a_line(metapp: Callable, photo: Path, tmp_path: Path, options: list[str], line: str) -> None:
    result = metapp("data", "ball", photo, "--out", tmp_path / "x", *options)
    assert line in (result.refusal if result.code == 1 else result.misuse)
    assert not (tmp_path / "x").exists()


@pytest.mark.long
def test_fits_merge_photos_of_several_exposures(metapp: Callable, bracket: list[Path], tmp_path: Path) -> None:
    options = ["--observe", "photo", "--recipe", "quick", "--out", tmp_path / "runs", "--json", "--quiet"]
    output = metapp("general", "illumination", *bracket, "--shutter", "1/40,1/20,1/10", *options).json_result
    assert [task["name"] for task in output["tasks"]] == ["b"]
    assert metapp("compare", output["out"], output["out"], "--json").json_result[
        "picture"
    ]  # the photos are found again


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["illumination", "--observe", "photo", "--shutter", "1/20,1/60"], "exposures: 2 for 3 photos"),
    ],
)
def test_fits_refuse_exposures_that_do_not_fit_in_a_line(
    metapp: Callable, bracket: list[Path], tmp_path: Path, words: list[str], line: str
) -> None:
    result = metapp("general", words[0], *bracket, *words[1:], "--out", tmp_path / "runs")
    assert line in (result.error if result.code == 1 else result.misuse)
    assert not list(tmp_path.glob("runs/*/*"))
