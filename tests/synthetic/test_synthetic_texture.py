"""The synthetic textures: varied, stationary, well exposed, the same for a seed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from data_tools.synthetic.stationary.families import FAMILIES
from data_tools.synthetic.texture import COUNTS, UNITS, synthetic_tasks
from metapp.learning.task import Task
from metapp.runs.embedded import embedded_data
from metapp.storage.shards import read_manifest

# Mean red, green and blue of three pictures, 0 .. 255.
EXPECTED = ((120.05, 94.97, 89.41), (184.26, 124.76, 93.63), (159.70, 158.05, 156.52))


@pytest.fixture(scope="module")
def train() -> list[Task]:
    return list(synthetic_tasks("train", 100))


@pytest.fixture(scope="module")
def test() -> list[Task]:
    return list(synthetic_tasks("test", COUNTS["test"]))


def images(tasks: list[Task]) -> Tensor:
    """[N, 3, 256, 256] in [0, 1]."""
    return torch.stack([task.data["image"] for task in tasks]).float() / 255


def histograms(pictures: Tensor) -> Tensor:
    """Shares of 8 levels of each channel, [N, 24]."""
    levels = (pictures.flatten(2) * 7.999).byte()
    return torch.stack([(levels == level).float().mean(2) for level in range(8)], -1).flatten(1)


def test_counts_names_and_tensors(train: list[Task], test: list[Task]) -> None:
    assert COUNTS == {"train": 240, "test": 20}
    names = [task.name for task in train + test]
    assert len(set(names)) == len(names) == 120
    assert names[0] == "bricks-000"
    assert names[100] == "bricks-t000"
    assert {name.split("-")[0] for name in names[:20]} == {name.split("-")[0] for name in names[100:]} == set(FAMILIES)
    for task in train + test:
        assert set(task.data) == set(UNITS)
        assert task.data["image"].dtype == torch.uint8
        assert task.data["image"].shape == (3, 256, 256)


def test_a_larger_set_begins_with_the_smaller_one_and_a_seed_changes_all(train: list[Task]) -> None:
    for one, two in zip(synthetic_tasks("train", 20), train, strict=False):
        assert one.name == two.name
        assert torch.equal(one.data["image"], two.data["image"])
    for one, two in zip(synthetic_tasks("train", 20, seed=1), train, strict=False):
        assert (one.data["image"].float() - two.data["image"].float()).abs().mean() > 2


def test_draws_are_the_same_on_every_machine(train: list[Task], test: list[Task]) -> None:
    """Whoever changes a draw changes the default data set, and with it every trained start and every table."""
    found = images([train[0], train[33], test[12]]).mean((2, 3)) * 255
    torch.testing.assert_close(found, torch.tensor(EXPECTED), rtol=0, atol=0.3)


def test_pictures_are_neither_black_nor_white_nor_flat(train: list[Task], test: list[Task]) -> None:
    pictures = images(train + test)
    means = pictures.mean((1, 2, 3))
    assert means.min() > 0.2
    assert means.max() < 0.85
    assert (pictures >= 1).all(1).float().mean((1, 2)).max() < 0.03
    assert (pictures.amax(1) < 0.02).float().mean((1, 2)).max() < 0.35
    assert pictures.std((2, 3)).amax(1).min() > 0.015


def test_most_pictures_are_the_same_everywhere(train: list[Task], test: list[Task]) -> None:
    """In nine of ten no quadrant's mean colour is further than 0.03 from the whole's."""
    pictures = images(train + test)
    quadrants = pictures.unflatten(3, (2, 128)).unflatten(2, (2, 128)).mean((3, 5))
    apart = (quadrants - pictures.mean((2, 3))[..., None, None]).abs().amax((1, 2, 3))
    assert (apart < 0.03).float().mean() > 0.9
    assert apart.max() < 0.1


def test_every_draw_is_another_texture(train: list[Task], test: list[Task]) -> None:
    pictures = images(train + test)
    small = torch.nn.functional.avg_pool2d(pictures, 8).flatten(1)
    apart = torch.cdist(small, small, p=1).fill_diagonal_(float("inf")) / small.shape[1]
    assert apart.min() > 0.01  # and with that no test texture is a training texture
    shares = histograms(pictures)
    differences = torch.cdist(shares, shares, p=1) / 6  # 1: no level in common
    off_diagonal = ~torch.eye(len(shares), dtype=torch.bool)
    assert differences[off_diagonal].mean() > 0.5
    assert (differences[off_diagonal] < 0.05).float().mean() < 0.01


def test_members_of_a_family_differ_in_colour(train: list[Task]) -> None:
    means = images(train).mean((2, 3))
    for family in range(20):
        own = means[family::20]
        assert torch.cdist(own, own).sum() / 20 > 0.05, train[family].name


def test_the_embedded_set_has_all_units(tmp_path: Path) -> None:
    manifest = read_manifest(embedded_data("texture", count=5, out=tmp_path / "textures", quiet=True))
    assert manifest.units == UNITS
    assert [entry.split for entry in manifest.tasks].count("test") >= 1


@pytest.mark.parametrize("arguments", [("validation", 1), ("train", -1), ("test", 5, -2)])
def test_impossible_sets_are_errors(arguments: tuple[Any, ...]) -> None:
    with pytest.raises(ValueError, match="expected"):
        next(synthetic_tasks(*arguments))


def test_another_size(tmp_path: Path) -> None:
    large, again = (next(synthetic_tasks("train", 1, size=96)).data["image"] for _ in range(2))
    assert large.shape == (3, 96, 96)
    assert torch.equal(large, again)
    assert not torch.equal(large, next(synthetic_tasks("train", 1, seed=1, size=96)).data["image"])
    folder = embedded_data("texture", count=2, out=tmp_path / "large", quiet=True, size=64)
    assert read_manifest(folder).notes["size"] == 64
    with pytest.raises(ValueError, match=r"^brdf: size 64, but its embedded set has one size; leave --size out\.$"):
        embedded_data("brdf", count=2, out=tmp_path / "no", quiet=True, size=64)
