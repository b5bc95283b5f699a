"""The synthetic textures and flash photographs: their sizes, and maps that make the photograph."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from data_tools.draws import stream
from data_tools.synthetic.stationary import families
from data_tools.synthetic.svbrdf_stationary import flash_photographs
from data_tools.synthetic.texture import synthetic_tasks
from metapp.appearance.flash import Maps, camera, expose, normal_from_height, positions, render
from metapp.runs.inputs.embedded import embedded_data
from metapp.storage.shards import read_manifest


def test_another_size(tmp_path: Path) -> None:
    large, again = (next(synthetic_tasks("train", 1, size=96)).data["image"] for _ in range(2))
    assert large.shape == (3, 96, 96)
    assert torch.equal(large, again)
    assert not torch.equal(large, next(synthetic_tasks("train", 1, seed=1, size=96)).data["image"])
    folder = embedded_data("texture", count=2, out=tmp_path / "large", quiet=True, options={"size": 64})
    assert read_manifest(folder).notes["size"] == 64
    with pytest.raises(
        ValueError, match=r"^brdf: size 64, but its embedded set has no such option; leave --size out\.$"
    ):
        embedded_data("brdf", count=2, out=tmp_path / "no", quiet=True, options={"size": 64})


# Under a flash


def test_the_truth_makes_the_photograph_without_its_exposure() -> None:
    """Maps of one value each: a photograph of those that the statistics tell is the one that they belong to."""
    size, one = 64, np.ones((1, 64, 64), np.float32)
    plain = families.Maps(0.3 * np.repeat(one, 3, 0), 0.06 * one, 0.5 * one, 0 * one)
    photo, _, truth = flash_photographs(plain, stream(3))
    means, deviations = truth[:, 0], truth[:, 1]
    assert truth.shape == (3, 2, 6)
    assert means[:, :3].std() < 1e-4
    torch.testing.assert_close(deviations, torch.full((3, 6), 1e-4), rtol=0, atol=2e-3)
    torch.testing.assert_close(means[:, 4:], torch.tensor([0.5, 0.0]).expand(3, 2), rtol=0, atol=2e-3)
    albedo, specular = means[0, 0] ** 2.2, means[0, 3] ** 2.2
    torch.testing.assert_close(specular / albedo, torch.tensor(0.06 / 0.3))
    square = torch.ones(1, size, size)
    maps = Maps(albedo * square.expand(3, -1, -1), specular * square, 0.5 * square, normal_from_height(0 * square))
    again = expose(render(maps, positions(size, size), camera(), camera(), falloff=1.0))
    assert (again - photo / 255).abs().mean() < 0.02  # but for the flash's exact place and cone
