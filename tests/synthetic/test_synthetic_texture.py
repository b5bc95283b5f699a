"""The synthetic textures: varied, stationary, well exposed, the same for a seed."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

from data_tools.synthetic.texture import synthetic_tasks
from metapp.runs.embedded import embedded_data
from metapp.storage.shards import read_manifest
from tests.synthetic.drawn import drawn, least_distance


@pytest.fixture(scope="module")
def pictures() -> Tensor:
    """[N, 3, 256, 256] in [0, 1]."""
    return drawn("texture").images()


def histograms(pictures: Tensor) -> Tensor:
    """Shares of 8 levels of each channel, [N, 24]."""
    levels = (pictures.flatten(2) * 7.999).byte()
    return torch.stack([(levels == level).float().mean(2) for level in range(8)], -1).flatten(1)


def test_pictures_are_neither_black_nor_white_nor_flat(pictures: Tensor) -> None:
    means = pictures.mean((1, 2, 3))
    assert means.min() > 0.2
    assert means.max() < 0.85
    assert (pictures >= 1).all(1).float().mean((1, 2)).max() < 0.03
    assert (pictures.amax(1) < 0.02).float().mean((1, 2)).max() < 0.35
    assert pictures.std((2, 3)).amax(1).min() > 0.015


def test_most_pictures_are_the_same_everywhere(pictures: Tensor) -> None:
    """In nine of ten no quadrant's mean colour is further than 0.03 from the whole's."""
    quadrants = pictures.unflatten(3, (2, 128)).unflatten(2, (2, 128)).mean((3, 5))
    apart = (quadrants - pictures.mean((2, 3))[..., None, None]).abs().amax((1, 2, 3))
    assert (apart < 0.03).float().mean() > 0.9
    assert apart.max() < 0.1


def test_every_draw_is_another_texture(pictures: Tensor) -> None:
    assert least_distance(pictures) > 0.01  # and with that no test texture is a training texture
    shares = histograms(pictures)
    differences = torch.cdist(shares, shares, p=1) / 6  # 1: no level in common
    off_diagonal = ~torch.eye(len(shares), dtype=torch.bool)
    assert differences[off_diagonal].mean() > 0.5
    assert (differences[off_diagonal] < 0.05).float().mean() < 0.01


def test_members_of_a_family_differ_in_colour(pictures: Tensor) -> None:
    means = pictures[:100].mean((2, 3))
    for family in range(20):
        own = means[family::20]
        assert torch.cdist(own, own).sum() / 20 > 0.05, family


def test_another_size(tmp_path: Path) -> None:
    large, again = (next(synthetic_tasks("train", 1, size=96)).data["image"] for _ in range(2))
    assert large.shape == (3, 96, 96)
    assert torch.equal(large, again)
    assert not torch.equal(large, next(synthetic_tasks("train", 1, seed=1, size=96)).data["image"])
    folder = embedded_data("texture", count=2, out=tmp_path / "large", quiet=True, size=64)
    assert read_manifest(folder).notes["size"] == 64
    with pytest.raises(ValueError, match=r"^brdf: size 64, but its embedded set has one size; leave --size out\.$"):
        embedded_data("brdf", count=2, out=tmp_path / "no", quiet=True, size=64)
