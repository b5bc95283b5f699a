"""`metapp data images`, `flash`, `laval`, `strips` and `maps` end to end: data sets of image files."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from metapp.storage.shards import list_data_set_problems, read_data_set, read_manifest
from tests.cli.messages import says
from tests.pictures import noise_image, write_image, write_noise_map, write_noise_photo, write_text

IN, OUT = Path("in"), Path("out")


class Set(NamedTuple):
    """Files and what a command makes of them."""

    make: Callable[[], None]
    words: str
    app: str
    train: str
    test: str
    notes: dict[str, object]
    shapes: dict[str, tuple[int, ...]]
    skipped: tuple[str, ...] = ()
    related: tuple[str, ...] = ()  # tasks of one group, and one of another


def strip(path: Path, tiles: int = 5) -> Path:
    values = np.random.default_rng(0).integers(20, 236, (40, 40 * tiles, 3), dtype=np.uint8)
    values[:, 40:80] = (128, 140, 250)
    return write_image(path, values)


def flat(path: Path, *colour: int) -> Path:
    return write_image(path, np.full((40, 40, 3), colour, np.uint8))


def material(folder: Path, name: str, tilt: int) -> None:
    colour = noise_image(40, 40, seed=tilt)
    write_image(folder / f"{name}_diffuse.png", colour)
    flat(folder / f"{name}_normal.png", 128 + tilt, 128, 250)
    write_image(folder / f"{name}_gloss.png", colour[..., :1])


def photographs() -> None:
    for index, name in enumerate(("bark", "sand", "grass", "sub/moss", "sub/wall", "rust")):
        write_noise_photo(IN / f"{name}.png", index)


def environments() -> None:
    for seed, name in enumerate(("a.exr", "b.hdr", "deep/er/c.exr", "deep/d.EXR", "e.exr")):
        write_noise_map(IN / name, seed)


def flashes() -> None:
    for seed, (number, image) in enumerate(FLASHES):
        write_noise_photo(IN / f"train_{number:02d}_{image}.png", seed)
    write_text(IN / "metadata.json")


def strips() -> None:
    for index in range(6):
        strip(IN / "deep" / f"{index};a{index}Xb{index};0X1.png")
        strip(IN / f"{index + 10};b{index}Xa{index};2Xdefault.png")
    strip(IN / "four.png", 4)
    write_text(IN / "notes.txt")


def materials() -> None:
    for index in range(5):
        material(IN / f"m{index}", f"rock{index}", index)
    material(IN / "m0", "variant", 0)
    flat(IN / "m1" / "odd_normal.png", 128, 128, 250)


FLASHES = [(number, image) for number in range(6) for image in range(1 + number % 3)]
STRIPS = [name for i in (0, 1, 2, 3, 5) for name in (f"{i}_a{i}Xb{i}_0X1", f"{i + 10}_b{i}Xa{i}_2Xdefault")]
BLENDS = {"size": 32, "gamma": 1.0, "white": 1.35}
MAPS = {"maps": (10, 32, 32), "photo": (3, 32, 32)}
LIGHT = {"map": (3, 64, 128), "scale": (), "photos": (4, 3, 64, 64)}
SETS = {
    "images": Set(
        photographs, "", "texture", "bark grass rust moss wall", "sand", {"size": 256}, {"image": (3, 256, 256)}
    ),
    "laval": Set(environments, "in/a.exr", "illumination", "a b c d", "e", {"rows": 64}, LIGHT),
    "flash": Set(
        flashes, "--size 32", "svbrdf_stationary", " ".join(f"{n:02d}_{i}" for n, i in FLASHES if n != 4), "04_0 04_1",
        {"size": 32}, {"image": (3, 32, 32)}, (), ("04_0", "04_1", "05_0"),
    ),
    "strips": Set(
        strips, "--size 32", "svbrdf_nonstationary", " ".join(STRIPS), "4_a4Xb4_0X1 14_b4Xa4_2Xdefault", BLENDS, MAPS,
        ("notes.txt", "four.png"), ("4_a4Xb4_0X1", "14_b4Xa4_2Xdefault", "5_a5Xb5_0X1"),
    ),
    "maps": Set(
        materials, "--size 32", "svbrdf_nonstationary", "rock0 rock1 rock2 rock3 variant", "rock4",
        {"size": 32, "normals": "auto"}, MAPS, ("odd",), ("rock0", "variant", "rock1"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SETS)
def test_files_become_a_data_set(name: str, metapp: Callable) -> None:
    case = SETS[name]
    case.make()
    result = metapp("data", name, IN, *case.words.split(), "--out", OUT, "--json")
    train, test = (dict.fromkeys(names.split(), split) for names, split in ((case.train, "train"), (case.test, "test")))
    document = result.json_document
    assert (document["app"], document["out"], len(document["skipped"])) == (case.app, "out", len(case.skipped))
    assert ({*document["train"]}, {*document["test"]}) == (train.keys(), test.keys())
    *lines, last = result.err.splitlines()
    assert says(last, case.app, f"{len(train)} train", f"{len(test)} test", "out")
    assert all(name in line for name, line in zip(case.skipped, lines, strict=True))
    assert list_data_set_problems(OUT) == []
    manifest = read_manifest(OUT)
    assert {entry.name: entry.split for entry in manifest.tasks} == train | test
    assert manifest.notes == {"made_by": f"metapp data {name}", **case.notes, "split": "auto"}
    shapes = [
        {key: tuple(value.shape) for key, value in task.data.items()} for task in read_data_set(OUT, app=case.app)
    ]
    assert shapes == [case.shapes] * len(manifest.tasks)
    groups = [next(entry.group for entry in manifest.tasks if entry.name == name) for name in case.related]
    assert [group == groups[0] for group in groups] == [True, True, False][: len(groups)]


def test_predicted_maps_become_a_method_of_the_baselines_table(metapp: Callable) -> None:
    for name in ("1", "2"):
        strip(IN / f"{name};a;0.png")
    for letter, colour in {"N": (128, 128, 255), "D": (90, 80, 70), "R": (99, 99, 99), "S": (60, 60, 60)}.items():
        write_image(Path("of") / f"1_{letter}.png", np.full((36, 36, 3), colour, np.uint8))
    convert = ("data", "strips", IN, "--out", OUT, "--split", "test", "--size", "36", "--overwrite")
    result = metapp(*convert, "--predicted", "of")
    assert says(result.err, "in/2;a;0.png", "of/2_N.png", "no such file")
    assert [entry.name for entry in read_manifest(OUT).tasks] == ["1_a_0"]  # what is not predicted is left out
    assert read_manifest(OUT).notes["predicted"] == "of"
    (task,) = read_data_set(OUT, "test", "svbrdf_nonstationary")
    assert {tuple(value.shape) for value in task.data.values()} == {(10, 36, 36), (3, 36, 36)}
    call = ("baseline", "svbrdf_nonstationary", "--observe", "photo", "--method", "predicted", "--data", OUT)
    judged = metapp(*call, "--recipe", "quick", "--json").json_result
    (record,) = judged["tasks"]
    assert record["errors"]["normal"] < 20
    assert {"seconds", "threads"}.isdisjoint(record)
    assert (Path(judged["out"]) / "1_a_0" / "normal.png").is_file()
    options = ("--observe", "photo", "--data", OUT, "--recipe", "quick")
    ours = metapp("general", "svbrdf_nonstationary", *options, "--json").json_result["out"]
    compared = metapp("compare", ours, judged["out"], "--json")
    assert compared.code == 0
    assert "no picture" in compared.err
    assert [side["label"] for side in compared.json_document["runs"]] == ["general", "predicted"]
    assert compared.json_document["runs"][1]["measures"]["normals, degrees"]["mean"] == record["errors"]["normal"]
    assert "normals, degrees: " in " ".join(metapp("compare", ours, judged["out"]).out.split())
    assert "1_a_0" in metapp(*call, "--recipe", "quick").out
    assert metapp(*convert).code == 0
    assert says(metapp(*call, "--recipe", "quick").error, "1_a_0", "no predicted maps")
