"""`metapp data ball`: files that it writes, and its refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from metapp.appearance.colour import linear_to_srgb
from metapp.cli.commands import app
from metapp.extensions.capture.ball.view import Ball
from metapp.storage.images import write_png
from metapp.storage.shards import check_shard, read_shard
from tests.extensions.capture.ball_photos import detailed, photograph


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    picture = torch.from_numpy(photograph(Ball(80, 75, 60), 150, 160, 0.02, detailed))
    write_png(linear_to_srgb(picture.clamp(0, 1)).permute(1, 2, 0), {"encoding": "sRGB"}, tmp_path / "a.png")
    return tmp_path / "a.png"


def test_a_data_set_a_map_and_what_was_found_are_written(photo: Path, tmp_path: Path) -> None:
    out = tmp_path / "garden"
    arguments = ["data", "ball", str(photo), "--ball", "80,75,60", "--size", "32", "--out", str(out), "--json"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout.splitlines()[-1])
    assert said["photos"][0]["radius"] == 60
    assert check_shard(out) == []
    (task,) = read_shard(out, "test", "illumination")
    assert task.name == "garden"
    assert task.data["photos"].shape == (1, 3, 64, 64)
    assert task.data["photos"].dtype == torch.uint8
    assert (task.data["photos"][..., 0, 0] == 0).all()
    assert task.data["seen"].shape == (3, 32, 64)
    assert task.data["certain"].shape == (2, 32, 64)
    assert float(task.data["certain"][0].mean()) == pytest.approx(said["seen"])
    assert (out / "garden.exr").is_file()
    assert (out / "found" / "a.png").is_file()


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--exposures", "a"], "expected exposure times"),
        (["--ball", "1,2"], "expected centre and radius"),
        (["--ball", "999,2,5"], "expected one in the picture"),
        (["--exposures", "1/20,1/60", "--ball", "80,75,60"], "expected one for each"),
    ],
)
def test_bad_options_are_a_line(photo: Path, tmp_path: Path, options: list[str], line: str) -> None:
    done = CliRunner().invoke(app, ["data", "ball", str(photo), "--out", str(tmp_path / "x"), *options])
    found = done.output + str(done.exception)
    assert line in " ".join(found.replace("│", " ").split())
    assert not (tmp_path / "x").exists()


@pytest.fixture
def bracket(tmp_path: Path) -> list[str]:
    picture = torch.from_numpy(photograph(Ball(80, 75, 60), 150, 160, 0.02, detailed))
    files = [tmp_path / f"{name}.png" for name in "bac"]
    for exposure, file in zip((0.5, 1.0, 2.0), files, strict=True):
        shown = linear_to_srgb((exposure * picture).clamp(0, 1)).permute(1, 2, 0)
        write_png(shown, {"encoding": "sRGB"}, file)
    return [str(file) for file in files]


@pytest.mark.long
@pytest.mark.parametrize(("exposures", "recipe"), [("1/40,1/20,1/10", "quick"), ("auto", "full")])
def test_fits_merge_photos_of_several_exposures(
    bracket: list[str], tmp_path: Path, exposures: str, recipe: str
) -> None:
    options = ["--observe", "photo", "--recipe", recipe, "--out", str(tmp_path / "runs"), "--json", "--quiet"]
    done = CliRunner().invoke(app, ["general", "illumination", *bracket, "--exposures", exposures, *options])
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout.splitlines()[-1])
    assert [task["name"] for task in said["tasks"]] == ["b"]
    again = CliRunner().invoke(app, ["rerun", str(Path(said["out"]) / "record.jsonl"), "--json", "--quiet"])
    assert again.exit_code == 0, again.output


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["illumination", "--observe", "photo", "--exposures", "1/20,1/60"], "2 exposure(s) for 3 photo(s)"),
        (["illumination", "--observe", "photo", "--exposures", "soon"], "expected exposure times"),
        (
            ["illumination", "--observe", "photo", "--exposures", "auto", "--batch", "2"],
            "--exposures makes one input of all; leave out --batch and --shard",
        ),
        (["illumination", "--exposures", "auto"], "--exposures: only with --observe photo; add that"),
        (
            ["svbrdf_nonstationary", "--observe", "photo", "--exposures", "auto"],
            "has no such option, only illumination",
        ),
    ],
)
def test_fits_refuse_exposures_that_do_not_fit_in_a_line(
    bracket: list[str], tmp_path: Path, words: list[str], line: str
) -> None:
    done = CliRunner().invoke(app, ["general", words[0], *bracket, *words[1:], "--out", str(tmp_path / "runs")])
    assert done.exit_code in (1, 2)
    assert line in " ".join((done.output + str(done.exception)).replace("│", " ").split())
    assert not list(tmp_path.glob("runs/*/*"))
