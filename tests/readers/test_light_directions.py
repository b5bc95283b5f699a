"""Photographs by a camera that stands still, with an RTI text of light directions: one input, and clear refusals."""

import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from data_tools.readers import placed_photos
from data_tools.readers.light_directions import FAR_HALF_SIDES, find_light_distance, read_lights
from metapp.appearance.flash import render_maps, texel_positions
from tests.apps.several.test_several_photos import relief
from tests.cli.messages import says
from tests.pictures import noise_image, write_image

COUNT = 4


def lights(names: list[str]) -> str:
    rows = [(math.cos(turn), math.sin(turn), 1.0) for turn in np.linspace(0, 5, len(names))]
    return f"{len(names)}\n" + "".join(f"{name} {x} {y} {z}\n" for name, (x, y, z) in zip(names, rows, strict=True))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Four photographs, 64 x 48, of which the text has another order than that of their names."""
    result = tmp_path / "coin"
    for number in range(COUNT):
        write_image(result / f"{number} b.png", noise_image(48, 64, seed=number))
    (result / "coin.lp").write_text(lights([f"C:\\photos\\{number} b.png" for number in (3, 1, 0, 2)]))
    return result


def test_a_folder_is_one_task_in_the_order_of_the_text(folder: Path) -> None:
    for path in (folder, folder / "coin.lp", folder.parent):
        (source,), skipped = placed_photos.find(path)
        assert placed_photos.recognises(path)
        assert (source.name, source.path.resolve(), skipped) == ("coin", folder.resolve(), [])
    paths, places = read_lights(folder / "coin.lp")
    assert [path.name for path in paths] == ["3 b.png", "1 b.png", "0 b.png", "2 b.png"]
    task = placed_photos.read_task(folder)
    assert task.data["others"].shape == (COUNT - 1, 3, 256, 256)
    assert torch.equal(task.data["places"][:, 0], places[:, 0])
    torch.testing.assert_close(
        *(torch.nn.functional.normalize(at[:, 1], dim=1) for at in (task.data["places"], places))
    )
    assert torch.equal(places[:, 0], torch.tensor([0.0, 0.0, FAR_HALF_SIDES]).expand(COUNT, 3))
    torch.testing.assert_close(places[:, 1].norm(dim=1), torch.full((COUNT,), FAR_HALF_SIDES))
    torch.testing.assert_close(places[0, 1] / FAR_HALF_SIDES, torch.tensor([1.0, 0.0, 1.0]) / math.sqrt(2))


@pytest.mark.parametrize("distance", [3.0, 8.0, 25.0])
def test_the_distance_of_lights_is_found(distance: float) -> None:
    turns = torch.arange(6) * math.pi / 3
    towards = torch.stack([0.6 * turns.cos(), 0.6 * turns.sin(), torch.full((6,), 0.8)], 1)
    places = torch.stack([torch.tensor([0.0, 0.0, 20.0]).expand(6, 3), towards], 1)
    maps = relief(64)
    lit = [
        render_maps(maps, texel_positions(64, 64), distance * way[None], places[:1, 0], intensity=torch.ones(1, 1))
        for way in towards
    ]
    assert find_light_distance(torch.cat(lit) * distance**2 / 2, places) == pytest.approx(distance, rel=0.25)


def test_lights_that_graze_the_material_are_left_out(folder: Path) -> None:
    text = (folder / "coin.lp").read_text().splitlines()
    (folder / "coin.lp").write_text("\n".join([*text[:-1], "2 b.png 1 0 0.1"]))
    assert [path.name for path in read_lights(folder / "coin.lp")[0]] == ["3 b.png", "1 b.png", "0 b.png"]


@pytest.mark.parametrize(
    ("change", "facts"),
    [
        (lambda text: text.replace("4\n", "5\n", 1), ("line 1", "'5'", "4 lines", "expected the number of photos")),
        (lambda text: "", ("no line", "expected the number of photos")),
        (lambda text: text.replace("3 b.png 1.0", "3 b.png x"), ("line 2", "expected a name and a direction x y z")),
        (lambda text: text.replace("3 b", "9 b"), ("line 2", "'9 b.png'", "no such file", "expected the photo")),
        (lambda text: text + "\0", ("expected the number of photos, then 'name x y z' for each",)),
        (lambda text: "0\n", ("line 1", "'0'", "0 lines", "expected the number of photos")),
        (lambda text: f"\n{text.replace('4', '²', 1)}", ("line 2", "'²'", "4 lines", "expected the number of photos")),
        (lambda text: text.replace("4", "4" * 5000, 1), ("line 1", "'44444", "4 lines", "expected the number")),
        (lambda text: text.replace("4", "-4", 1), ("line 1", "'-4'", "4 lines", "expected the number of photos")),
    ],
)
def test_texts_that_are_none_are_refused_in_one_line(
    metapp: Callable, folder: Path, change: Callable[[str], str], facts: tuple[str, ...]
) -> None:
    path = folder / "coin.lp"
    path.write_text(change(path.read_text()))
    with pytest.raises(ValueError, match="expected") as caught:
        read_lights(path)
    assert says(str(caught.value), str(path), *facts)
    assert says(metapp("general", "svbrdf_nonstationary", folder).error, "coin.lp", *facts)


def test_the_count_may_have_leading_zeros(folder: Path) -> None:
    path = folder / "coin.lp"
    path.write_text("00" + path.read_text())
    assert len(read_lights(path)[0]) == COUNT


@pytest.mark.parametrize("name", ["coin.lp", "camera_pos.txt"])
@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo], ids=["folder", "pipe"])
def test_a_text_that_is_a_folder_or_a_pipe_is_not_ignored(
    metapp: Callable, folder: Path, name: str, make: Callable[[Path], None]
) -> None:
    (folder / "coin.lp").unlink()
    (folder / "image_size.txt").write_text("10")
    make(folder / name)
    for path in (folder, folder.parent):
        assert says(metapp("general", "svbrdf_nonstationary", path).error, name, "expected")


def test_photographs_of_several_sizes_and_texts_are_refused(metapp: Callable, folder: Path) -> None:
    write_image(folder / "0 b.png", noise_image(48, 48))
    assert (
        "expected photos of one size, by a camera that stands"
        in metapp("general", "svbrdf_nonstationary", folder).error
    )
    (folder / "other.lp").write_text("0\n")
    assert "expected one text of light directions" in metapp("general", "svbrdf_nonstationary", folder).error
