"""Real materials for training: what they lack is known, and drawn ones stand beside them."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Generator

from metapp.storage.shards import read_data_set
from tests.readers.test_material_maps import folder

APP = "svbrdf_nonstationary"


@pytest.mark.parametrize(
    ("maps", "map_weights"),
    [
        ({}, [1.0, 1.0, 1.0, 1.0]),
        ({"specular": 0.5}, [1.0, 1.0, 1.0, 1.0]),
        ({"roughness": None}, [1.0, 0.0, 0.0, 1.0]),
        ({"roughness": None, "specular": 0.5}, [0.3, 0.0, 0.0, 1.0]),
        ({"roughness": None, "gloss": 0.4}, [1.0, 1.0, 1.0, 1.0]),
    ],
)
def test_parts_that_a_set_lacks_are_marked_unknown(
    metapp: Callable, tmp_path: Path, maps: dict, map_weights: list[float]
) -> None:
    given = folder(tmp_path / "rock", **maps)
    assert metapp("data", "materials", given, "--size", "32", "--split", "train", "--out", tmp_path / "set").code == 0
    (task,) = read_data_set(tmp_path / "set", "train")
    torch.testing.assert_close(task.data["map_weights"], torch.tensor(map_weights))
    assert task.data["kind"].tolist() == [1]
    assert task.data["maps"].shape == (10, 32, 32)
    if "roughness" in maps and "gloss" not in maps:
        assert set(task.data["maps"][6:].unique().tolist()) == {*torch.tensor([0.6, 0.04]).half().tolist()}


@pytest.mark.parametrize("size", [32, 128, 160])
def test_maps_that_are_smaller_are_repeated(metapp: Callable, tmp_path: Path, rng: Generator, size: int) -> None:
    """Such sets tile; larger ones are made smaller."""
    given = folder(tmp_path / "rock", diffuse=torch.rand(3, 64, 64, generator=rng))
    for side in (64, size):
        words = ("data", "materials", given, "--size", side, "--split", "train", "--out", tmp_path / f"{side}")
        assert metapp(*words).code == 0
    own, result = (read_data_set(tmp_path / f"{side}", "train")[0].data for side in (64, size))
    assert result["photo"].shape[-1] == result["maps"].shape[-1] == size
    if size > 64:
        assert torch.equal(result["maps"], own["maps"].repeat(1, 3, 3)[:, :size, :size])
    else:
        pooled = torch.nn.functional.avg_pool2d(own["maps"][3:6].float(), 2)
        torch.testing.assert_close(result["maps"][3:6].float(), pooled, atol=0.02, rtol=0)


def test_drawn_materials_stay_as_they_are(metapp: Callable, tmp_path: Path) -> None:
    scan = folder(tmp_path / "rock")
    assert metapp("data", "synth", APP, "--count", "4", "--size", "32", "--out", tmp_path / "drawn").code == 0
    words = ("data", "materials", scan, tmp_path / "drawn", "--size")
    assert metapp(*words, "32", "--out", tmp_path / "set").code == 0
    drawn = {task.name: task.data for task in read_data_set(tmp_path / "drawn", "train")}
    mixed = {task.name: task.data for task in read_data_set(tmp_path / "set")}
    assert mixed.keys() > drawn.keys()
    for name, data in drawn.items():
        assert all(torch.equal(mixed[name][key], value) for key, value in data.items())
    assert {name for name, data in mixed.items() if int(data["kind"])} == {"rock"}
    refused = metapp(*words, "64", "--out", tmp_path / "other")
    assert refused.code == 1
    assert "maps of 32 px, expected maps of 64 px" in " ".join(refused.err.split())
    assert metapp("data", "materials", scan.parent / "none", "--out", tmp_path / "other").code == 1


def test_a_set_without_normals_is_refused(metapp: Callable, tmp_path: Path) -> None:
    given = folder(tmp_path / "rock", normal=None, roughness=None, specular=0.5)
    result = metapp("data", "materials", given, "--out", tmp_path / "set")
    assert result.code == 1
    assert "no normal map" in " ".join(result.err.split())
