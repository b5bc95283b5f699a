"""`metapp data strips` and `metapp data maps` end to end."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from metapp.storage.manifest import fingerprint, read_manifest
from metapp.storage.shards import check_shard, read_shard


def write(path: Path, values: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    output = oiio.ImageOutput.create(str(path))
    output.open(str(path), oiio.ImageSpec(values.shape[1], values.shape[0], values.shape[2], "uint8"))
    output.write_image(np.ascontiguousarray(values))
    output.close()
    return path


def strip(path: Path, tiles: int = 5) -> Path:
    values = np.random.default_rng(0).integers(20, 236, (40, 40 * tiles, 3), dtype=np.uint8)
    values[:, 40:80] = (128, 140, 250)
    return write(path, values)


def material(folder: Path, name: str, tilt: int = 0) -> Path:
    colour = np.random.default_rng(tilt).integers(0, 256, (40, 40, 3), dtype=np.uint8)
    write(folder / f"{name}_diffuse.png", colour)
    write(folder / f"{name}_normal.png", np.full((40, 40, 3), (128 + tilt, 128, 250), np.uint8))
    write(folder / f"{name}_gloss.png", colour[..., :1])
    return folder


def splits(out: Path) -> dict[str, str]:
    assert check_shard(out) == []
    return {entry.name: entry.split for entry in read_manifest(out).tasks}


def test_strips_become_a_data_set(metapp: Callable, tmp_path: Path) -> None:
    for index in range(6):
        strip(tmp_path / "in" / "deep" / f"{index};a{index}Xb{index};0X1.png")
        strip(tmp_path / "in" / f"{index + 10};b{index}Xa{index};2Xdefault.png")
    strip(tmp_path / "in" / "four.png", 4)
    (tmp_path / "in" / "notes.txt").write_text("in words")
    out = tmp_path / "out"
    result = metapp("data", "strips", tmp_path / "in", "--out", out, "--size", "32", "--json")
    assert result.code == 0
    *lines, last = result.err.splitlines()
    assert [line.partition("skipped: ")[2].rpartition("/")[2].partition(":")[0] for line in lines] == [
        "notes.txt", "four.png"
    ]  # fmt: skip
    assert last == f"svbrdf_nonstationary: 10 train + 2 test tasks in {out}; 2 skipped"
    assert {name for name, split in splits(out).items() if split == "test"} == {"4_a4Xb4_0X1", "14_b4Xa4_2Xdefault"}
    manifest = read_manifest(out)
    assert manifest.notes == {
        "made_by": "metapp data strips", "size": 32, "gamma": 1.0, "white": 1.35, "split_by": "material", "left_out": 0,
        "split": "auto",
    }  # fmt: skip
    assert {entry.name: entry.group for entry in manifest.tasks}["14_b4Xa4_2Xdefault"] == "a4"
    task = read_shard(out, "test", "svbrdf_nonstationary")[0]
    assert {key: tuple(value.shape) for key, value in task.data.items()} == {
        "maps": (10, 32, 32), "photo": (3, 32, 32)
    }  # fmt: skip
    assert "no problems" in metapp("data", "check", out).out


def test_strips_that_share_all_their_materials(metapp: Callable, tmp_path: Path) -> None:
    for index in range(6):
        strip(tmp_path / "in" / f"{index};aXb;{index}X{index}.png")
    strip(tmp_path / "in" / "6;aXb;0X1.png")
    result = metapp("data", "strips", tmp_path / "in", "--out", tmp_path / "out", "--json")
    assert result.code == 0
    assert result.err.splitlines()[0] == (
        "warning: base materials are blended with all others: training and test strips show other presets of them."
    )
    assert sorted(splits(tmp_path / "out").values()).count("test") == 2
    notes = read_manifest(tmp_path / "out").notes
    assert notes["split_by"] == "preset"
    left_out = notes["left_out"]
    assert (f"warning: {left_out} of 7 strips left out: they blend" in result.err) == (left_out > 0)
    assert len(splits(tmp_path / "out")) == 7 - left_out


def test_options_of_strips(metapp: Callable, tmp_path: Path) -> None:
    path = strip(tmp_path / "a.png")
    for name, arguments in {"one": (), "two": (), "gamma": ("--gamma", "2.2")}.items():
        call = ("data", "strips", path, "--out", tmp_path / name, "--split", "test", "--quiet", *arguments)
        assert metapp(*call) == (0, "", "")
    assert splits(tmp_path / "one") == {"a": "test"}
    assert fingerprint(tmp_path / "one") == fingerprint(tmp_path / "two") != fingerprint(tmp_path / "gamma")
    means = [read_shard(tmp_path / name)[0].data["maps"][3:6].float().mean().item() for name in ("one", "gamma")]
    assert means[1] < 0.8 * means[0]
    for arguments in (("--split", "some"), ("--size", "4"), ("--gamma", "0"), ("--white", "0")):
        assert metapp("data", "strips", path, "--out", tmp_path / "new", *arguments).code == 2
    assert not (tmp_path / "new").exists()


def test_maps_become_a_data_set(metapp: Callable, tmp_path: Path) -> None:
    for index in range(5):
        material(tmp_path / "in" / f"m{index}", f"rock{index}", index)
    material(tmp_path / "in" / "m0", "variant", 0)
    write(tmp_path / "in" / "m1" / "odd_normal.png", np.full((40, 40, 3), (128, 128, 250), np.uint8))
    out = tmp_path / "out"
    result = metapp("data", "maps", tmp_path / "in", "--out", out, "--size", "32", "--json")
    assert result.code == 0
    line, last = result.err.splitlines()
    assert "odd: no base colour map (odd_normal.png)" in line
    assert last == f"svbrdf_nonstationary: 5 train + 1 test tasks in {out}; 1 skipped"
    assert [name for name, split in splits(out).items() if split == "test"] == ["rock4"]
    assert read_manifest(out).notes == {
        "made_by": "metapp data maps", "size": 32, "normals": "auto", "split": "auto"
    }  # fmt: skip
    groups = {entry.name: entry.group for entry in read_manifest(out).tasks}
    assert groups["rock0"] == groups["variant"] != groups["rock1"]
    joined = metapp("data", "join", out, out, "--out", tmp_path / "twice")
    assert joined.code == 1  # the same names


def test_options_of_maps(metapp: Callable, tmp_path: Path) -> None:
    path = material(tmp_path / "in", "rock")
    for option, sign in (("opengl", 1), ("directx", -1)):
        write(path / "rock_normal.png", np.full((40, 40, 3), (128, 180, 230), np.uint8))
        call = ("data", "maps", path, "--out", tmp_path / option, "--split", "test", "--normals", option, "--quiet")
        assert metapp(*call) == (0, "", "")
        assert splits(tmp_path / option) == {"rock": "test"}
        assert sign * read_shard(tmp_path / option)[0].data["maps"][1].float().mean() > 0.3
    assert metapp("data", "maps", path, "--out", tmp_path / "new", "--normals", "left").code == 2


def without(folder: Path, role: str) -> Path:
    (material(folder, "rock") / f"rock_{role}.png").unlink()
    return folder


BAD: dict[str, tuple[str, Callable[[Path], Path], str]] = {
    "four tiles": (
        "strips",
        lambda folder: strip(folder / "a.png", 4),
        "a.png: 160x40 px, 4 tiles, expected 5 squares",
    ),
    "missing strip": ("strips", lambda folder: folder / "a.png", "a.png: no such file"),
    "same names": (
        "strips",
        lambda folder: [strip(folder / "b;c.png"), strip(folder / "b_c.png"), folder][-1],
        "two tasks named 'b_c'",
    ),
    "missing normal": ("maps", lambda folder: without(folder, "normal"), "rock: no normal map (rock_diffuse.png, "),
    "no maps": ("maps", lambda folder: strip(folder / "a.png").parent, "in: no maps in this folder (a.png), expected"),
    "no folder": ("maps", lambda folder: folder / "none", "none: no such file"),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_paths_end_the_conversion_in_one_line(metapp: Callable, tmp_path: Path, kind: str) -> None:
    command, make, message = BAD[kind]
    (tmp_path / "in").mkdir()
    result = metapp("data", command, make(tmp_path / "in"), "--out", tmp_path / "new" / "out")
    assert result.code == 1
    assert result.out == ""
    assert result.err.startswith("error: ")
    assert message in result.err
    assert result.err.count("\n") == 1
    assert not (tmp_path / "new").exists()
