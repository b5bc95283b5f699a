"""`metapp data images`, `flash`, `laval`, `strips` and `maps` end to end: data sets of image files."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from metapp.storage.shards import check_shard, read_manifest, read_shard
from tests.pictures import environment, noise, photograph, text, write

IN, OUT = Path("in"), Path("out")


def strip(path: Path, tiles: int = 5) -> Path:
    values = np.random.default_rng(0).integers(20, 236, (40, 40 * tiles, 3), dtype=np.uint8)
    values[:, 40:80] = (128, 140, 250)
    return write(path, values)


def flat(path: Path, *colour: int) -> Path:
    return write(path, np.full((40, 40, 3), colour, np.uint8))


def material(folder: Path, name: str = "rock", tilt: int = 0, without: str = "") -> Path:
    colour = noise(40, 40, seed=tilt)
    write(folder / f"{name}_diffuse.png", colour)
    flat(folder / f"{name}_normal.png", 128 + tilt, 128, 250)
    write(folder / f"{name}_gloss.png", colour[..., :1])
    if without:
        (folder / f"{name}_{without}.png").unlink()
    return folder


def splits() -> dict[str, str]:
    assert check_shard(OUT) == []
    return {entry.name: entry.split for entry in read_manifest(OUT).tasks}


def shapes_of(split: str, app: str) -> dict[str, tuple[int, ...]]:
    (task, *_) = read_shard(OUT, split, app)
    return {key: tuple(value.shape) for key, value in task.data.items()}


# Photographs and environment maps


def test_photographs_become_texture_tasks(metapp: Callable) -> None:
    for index, name in enumerate(("bark", "sand", "grass", "sub/moss", "sub/wall", "rust")):
        photograph(IN / f"{name}.png", index)
    train, test = ["bark", "grass", "rust", "moss", "wall"], ["sand"]
    document = metapp("data", "images", IN, "--out", OUT, "--json").document
    assert document == {"app": "texture", "out": "out", "train": train, "test": test, "skipped": []}
    assert set(splits()) == {*train, *test}
    assert read_manifest(OUT).notes == {"made_by": "metapp data images", "size": 256, "split": "auto"}
    assert {task.data["image"].shape for task in read_shard(OUT)} == {(3, 256, 256)}
    result = metapp("data", "images", IN / "bark.png", "--out", OUT, "--split", "test", "--size", "64", "--overwrite")
    assert result == (0, "", "texture: 0 train + 1 test tasks in out\n")
    assert shapes_of("test", "texture") == {"image": (3, 64, 64)}


def test_environment_maps_become_a_data_set(metapp: Callable) -> None:
    for seed, name in enumerate(("a.exr", "b.hdr", "deep/er/c.exr", "deep/d.EXR", "e.exr")):
        environment(IN / name, seed)
    result = metapp("data", "laval", IN, IN / "a.exr", "--out", OUT, "--json")
    assert result.err == "illumination: 4 train + 1 test tasks in out\n"
    assert sorted(result.document["train"]) == ["a", "b", "c", "d"]
    assert (result.document["app"], result.document["test"]) == ("illumination", ["e"])
    assert splits()["e"] == "test"
    assert read_manifest(OUT).notes == {"made_by": "metapp data laval", "rows": 64, "split": "auto"}
    assert shapes_of("test", "illumination") == {"map": (3, 64, 128), "scale": (), "photos": (4, 3, 64, 64)}


def test_flash_photographs_are_split_by_material(metapp: Callable) -> None:
    names = [f"train_{material:02d}_{image}" for material in range(6) for image in range(1 + material % 3)]
    for seed, name in enumerate(names):
        photograph(IN / f"{name}.png", seed)
    text(IN / "metadata.json")
    document = metapp("data", "flash", IN, "--out", OUT, "--size", "32", "--json").document
    assert document["app"] == "svbrdf_stationary"
    assert document["test"] == ["04_0", "04_1"]
    assert len(document["train"]) == len(names) - 2
    assert document["skipped"] == []
    assert read_manifest(OUT).notes == {"made_by": "metapp data flash", "size": 32, "split": "auto"}
    assert {task.data["image"].shape for task in read_shard(OUT)} == {(3, 32, 32)}


# Strips and maps of materials


def test_strips_become_a_data_set(metapp: Callable) -> None:
    for index in range(6):
        strip(IN / "deep" / f"{index};a{index}Xb{index};0X1.png")
        strip(IN / f"{index + 10};b{index}Xa{index};2Xdefault.png")
    strip(IN / "four.png", 4)
    text(IN / "notes.txt")
    result = metapp("data", "strips", IN, "--out", OUT, "--size", "32", "--json")
    assert result.code == 0
    *lines, last = result.err.splitlines()
    names = [line.partition("skipped: ")[2].rpartition("/")[2].partition(":")[0] for line in lines]
    assert names == ["notes.txt", "four.png"]
    assert last == "svbrdf_nonstationary: 10 train + 2 test tasks in out; 2 skipped"
    assert {name for name, split in splits().items() if split == "test"} == {"4_a4Xb4_0X1", "14_b4Xa4_2Xdefault"}
    manifest = read_manifest(OUT)
    notes = {"size": 32, "gamma": 1.0, "white": 1.35, "split": "auto"}
    assert manifest.notes == {"made_by": "metapp data strips", **notes}
    assert {entry.name: entry.group for entry in manifest.tasks}["14_b4Xa4_2Xdefault"] == "a4"
    assert shapes_of("test", "svbrdf_nonstationary") == {"maps": (10, 32, 32), "photo": (3, 32, 32)}


def test_predicted_maps_become_a_method_of_the_baselines_table(metapp: Callable) -> None:
    for name in ("1", "2"):
        strip(IN / f"{name};a;0.png")
    for letter, colour in {"N": (128, 128, 255), "D": (90, 80, 70), "R": (99, 99, 99), "S": (60, 60, 60)}.items():
        write(Path("of") / f"1_{letter}.png", np.full((36, 36, 3), colour, np.uint8))
    convert = ("data", "strips", IN, "--out", OUT, "--split", "test", "--size", "36", "--overwrite")
    done = metapp(*convert, "--predicted", "of")
    assert "in/2;a;0.png: of/2_N.png: no such file" in done.err
    assert list(splits()) == ["1_a_0"]  # what is not predicted is left out
    assert read_manifest(OUT).notes["predicted"] == "of"
    assert set(shapes_of("test", "svbrdf_nonstationary").values()) == {(10, 36, 36), (3, 36, 36)}
    call = ("baseline", "svbrdf_nonstationary", "--observe", "photo", "--method", "predicted", "--data", OUT)
    judged = metapp(*call, "--recipe", "quick", "--json").done
    (record,) = judged["tasks"]
    assert record["normal"] < 20
    assert {"seconds", "threads"}.isdisjoint(record)
    assert (Path(judged["out"]) / "1_a_0" / "normal.png").is_file()
    options = ("--observe", "photo", "--data", OUT, "--recipe", "quick")
    ours = metapp("general", "svbrdf_nonstationary", *options, "--json").done["out"]
    compared = metapp("compare", ours, judged["out"], "--json")
    assert compared.code == 0
    assert "no picture" in compared.err
    assert [side["label"] for side in compared.document["runs"]] == ["general", "predicted"]
    assert compared.document["measures"]["normals, degrees"]["means"][1] == record["normal"]
    assert "normals, degrees: " in " ".join(metapp("compare", ours, judged["out"]).out.split())
    assert "1_a_0" in metapp(*call, "--recipe", "quick").out
    assert metapp(*convert).code == 0
    assert "1_a_0: no predicted maps, expected some" in metapp(*call, "--recipe", "quick").error
    assert "'nowhere': no such folder" in metapp(*convert, "--predicted", "nowhere").misuse


def test_maps_of_materials_become_a_data_set(metapp: Callable) -> None:
    for index in range(5):
        material(IN / f"m{index}", f"rock{index}", index)
    material(IN / "m0", "variant", 0)
    flat(IN / "m1" / "odd_normal.png", 128, 128, 250)
    result = metapp("data", "maps", IN, "--out", OUT, "--size", "32", "--json")
    assert result.code == 0
    line, last = result.err.splitlines()
    assert "odd: no base colour map (odd_normal.png)" in line
    assert last == "svbrdf_nonstationary: 5 train + 1 test tasks in out; 1 skipped"
    assert [name for name, split in splits().items() if split == "test"] == ["rock4"]
    manifest = read_manifest(OUT)
    assert manifest.notes == {"made_by": "metapp data maps", "size": 32, "normals": "auto", "split": "auto"}
    groups = {entry.name: entry.group for entry in manifest.tasks}
    assert groups["rock0"] == groups["variant"] != groups["rock1"]
