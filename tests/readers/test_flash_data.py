"""Flash photographs: which material each shows, and that no material is on both sides of a split."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
import torch

from data_tools.formats import Label
from data_tools.readers import flash
from data_tools.readers.flash import find_shown, shown, split_by_material
from data_tools.readers.photos import read_photo
from tests.pictures import noise, write


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def splits_of(folder: Path) -> dict[str, str]:
    """The split of each photograph of a folder, by the name of its task."""
    return {label.name: label.split for label in split_by_material(find_shown([folder])).values()}


def test_a_task_is_named_by_material_and_image(tmp_path: Path) -> None:
    path = write(tmp_path / "train_0231_IMG_0785.png", noise(40, 60))
    task = flash.read_task(path, 40)
    assert task.name == "0231_IMG_0785"
    assert list(task.data) == list(flash.UNITS) == ["image"]
    assert torch.equal(task.data["image"], read_photo(path, 40))
    assert flash.read_task(path).data["image"].shape == (3, 256, 256)
    assert flash.recognises(tmp_path)
    assert flash.recognises(path)
    assert flash.find([tmp_path]) == ([path], [])


def test_the_material_follows_from_name_and_place(tmp_path: Path) -> None:
    told = {
        "train_0231_IMG_0785.jpg": Label("0231_IMG_0785", "0231", "train"),
        "deep/Test_gold_a.jpg": Label("gold_a", "gold", "test"),
        "test/0280/IMG_0786.JPG": Label("0280_IMG_0786", "0280", "test"),
        "Train/tin.jpg": Label("tin", "tin", "train"),
        "wood/IMG_1.jpg": Label("wood_IMG_1", "wood", ""),
        "box/wood/IMG_1.jpg": Label("wood_IMG_1", "wood", ""),
        "stone.jpg": Label("stone", "stone", ""),
        "test_stone.jpg": Label("test_stone", "test_stone", ""),
    }
    for name, expected in told.items():
        assert shown(tmp_path / name, tmp_path) == expected


def test_what_lies_above_the_named_folder_says_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "test" / "photographs"
    assert shown(folder / "a.jpg", folder) == Label("a", "a", "")
    assert shown(folder / "wood" / "a.jpg", folder) == Label("wood_a", "wood", "")
    # but the folder itself does, and so does the place of a file that was named
    assert shown(tmp_path / "test" / "gold" / "a.jpg", tmp_path / "test") == Label("gold_a", "gold", "test")
    assert shown(tmp_path / "test" / "gold" / "a.jpg") == Label("gold_a", "gold", "test")
    assert shown(tmp_path / "photographs" / "a.jpg") == Label("a", "a", "")


def test_relative_paths_tell_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    touch(tmp_path, "train/gold/a.jpg", "wood/a.jpg")
    monkeypatch.chdir(tmp_path)
    for start in (Path(), Path("train/..")):
        assert {each.name for each in find_shown([start]).values()} == {"gold_a", "wood_a"}
    monkeypatch.chdir(tmp_path / "train")
    assert [each.split for each in find_shown([Path()]).values()] == ["train"]


@pytest.mark.parametrize(
    "layout", ["train_{material}_{image}.jpg", "{material}/{image}.jpg", "train/{material}/{image}.jpg"]
)
def test_every_fifth_material_is_for_tests_whole(tmp_path: Path, layout: str) -> None:
    rng = random.Random(0)
    counts = {f"m{i:02d}": rng.randint(1, 4) for i in range(23)}
    for material, count in counts.items():
        touch(tmp_path, *(layout.format(material=material, image=f"i{image}") for image in range(count)))
    split = splits_of(tmp_path)
    assert len(split) == sum(counts.values())
    sides = {side: {name.partition("_")[0] for name in split if split[name] == side} for side in ("train", "test")}
    assert sides["test"] == {"m04", "m09", "m14", "m19"}
    assert sides["train"] == set(counts) - sides["test"]
    assert splits_of(tmp_path) == split


def test_photographs_without_material_are_split_alone(tmp_path: Path) -> None:
    touch(tmp_path, *(f"{name}.png" for name in "abcdefghijk"))
    assert [name for name, side in splits_of(tmp_path).items() if side == "test"] == ["e", "j"]


def test_stated_splits_hold_where_both_occur(tmp_path: Path) -> None:
    touch(tmp_path, "test_a_1.jpg", "test_a_2.jpg", "train_b_1.jpg", "test/c/1.jpg", "train/d.jpg", "metadata.json")
    assert splits_of(tmp_path) == {"a_1": "test", "a_2": "test", "b_1": "train", "c_1": "test", "d": "train"}
    assert flash.find([tmp_path])[1] == []
    touch(tmp_path, "e.jpg")  # one that says nothing: the rule decides on all
    assert {name for name, side in splits_of(tmp_path).items() if side == "test"} == {"e"}


def test_a_material_on_both_sides_is_refused(tmp_path: Path) -> None:
    touch(tmp_path, "train_a_1.jpg", "test_a_2.jpg")
    with pytest.raises(ValueError, match=r"test_a_2.jpg and .*train_a_1.jpg: training and test .* material 'a'"):
        splits_of(tmp_path)


def test_a_photograph_found_twice_shows_one_material(tmp_path: Path) -> None:
    touch(tmp_path, "wood/a.jpg", "wood/b.jpg")
    for paths in ([tmp_path, tmp_path / "wood", tmp_path / "wood/a.jpg"], [tmp_path / "wood/a.jpg", tmp_path]):
        assert [each.group for each in find_shown(paths).values()] == ["wood", "wood"]


def test_bad_paths_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no image in this folder"):
        find_shown([tmp_path])
    with pytest.raises(ValueError, match=r"none.jpg: no such file"):
        find_shown([tmp_path / "none.jpg"])
