"""`metapp data ball`: files that it writes, and its refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from data_tools.balls.view import Ball
from metapp.appearance.colour import linear_to_srgb
from metapp.cli.commands import app
from metapp.storage.images import write_png
from metapp.storage.shards import check_shard, read_shard
from tests.ball_photos import detailed, photograph


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
