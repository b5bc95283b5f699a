"""The samples of BRDF tasks: how they are spread, which are warned of, and what measurements make of them."""

import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from data_tools.readers.brdf_task import UNITS, make_brdf_task
from data_tools.readers.merl import (
    CHANNEL_SCALES,
    merl_centres,
    merl_index,
    merl_valid_mask,
    tabulate_merl,
    task_of_table,
)
from data_tools.readers.nbrdf_files import NBRDF_ARRAY_SHAPES, write_nbrdf
from data_tools.readers.nbrdf_files import read_task as read_network
from metapp.appearance.geometry import is_above_horizon
from metapp.storage.shards import list_data_set_problems, write_data_set


def evaluate(angles: Tensor) -> Tensor:
    return torch.stack([angles[..., 0].cos(), 0.2 + 0 * angles[..., 1], angles[..., 2] / 4], dim=-1)


@pytest.fixture(scope="module")
def table() -> np.ndarray:
    table = tabulate_merl(evaluate)
    table[np.random.default_rng(0).random(table.shape[:3]) < 0.2] = -CHANNEL_SCALES
    return table


def discrepancy(angles: Tensor, cells: int) -> float:
    """Root mean square relative deviation from the mean count over a grid of cells well above the horizon."""
    inside = angles[(angles[:, :2] < math.pi / 4).all(1)] / torch.tensor([math.pi / 4, math.pi / 4, 2 * math.pi])
    bins = (inside * cells).long().clamp_max(cells - 1)
    counts = torch.bincount((bins[:, 0] * cells + bins[:, 1]) * cells + bins[:, 2], minlength=cells**3).float()
    return float((counts / counts.mean() - 1).square().mean().sqrt())


def test_an_analytic_task(tmp_path: Path) -> None:
    task = make_brdf_task("paint", evaluate, samples=4096)
    assert task.name == "paint"
    assert {key: (tuple(value.shape), value.dtype) for key, value in task.data.items()} == {
        "angles": ((4096, 3), torch.float32),
        "reflectance": ((4096, 3), torch.float32),
        "render": ((96, 96, 4), torch.float32),
        "environment": ((48, 48, 4), torch.float32),
    }
    angles = task.data["angles"]
    assert is_above_horizon(angles).all()
    assert (angles >= 0).all()
    assert (angles <= torch.tensor([math.pi / 2, math.pi / 2, 2 * math.pi])).all()
    for half in angles.split(2048):  # seen and held out
        assert float((half[:, 2] > math.pi).float().mean()) == pytest.approx(0.5, abs=0.02)
    torch.testing.assert_close(task.data["reflectance"], evaluate(angles))
    assert task.data["render"][48, 48, 3] == 1
    assert task.data["render"][0, 0].tolist() == [0, 0, 0, 0]
    assert (task.data["render"][48, 48, :3] > 0).all()
    write_data_set(tmp_path, "brdf", UNITS, [(make_brdf_task("a", evaluate, samples=64), "train", "")])
    assert list_data_set_problems(tmp_path) == []


def test_the_same_samples_for_all_materials_of_a_seed() -> None:
    first = make_brdf_task("a", evaluate, samples=1000).data["angles"]
    first_copy = first.clone()
    first.zero_()  # tasks share nothing
    second = make_brdf_task("b", lambda angles: 2 * evaluate(angles), samples=1000).data["angles"]
    assert torch.equal(first_copy, second)
    assert not torch.equal(second, make_brdf_task("a", evaluate, samples=1000, seed=1).data["angles"])


def test_both_halves_and_prefixes_are_well_spread() -> None:
    angles = make_brdf_task("a", evaluate, samples=16384).data["angles"]
    for part in (angles[:8192], angles[8192:], angles):
        # Independent draws deviate by sqrt(cells / draws) = 0.35 (whole: 0.25) here; stratified ones by much less.
        assert discrepancy(part, 8) < 0.75 * math.sqrt(8**3 / (0.4 * len(part)))
    for size in (512, 2048):  # a prefix is a random part of its half
        torch.testing.assert_close(angles[:size].mean(0), angles.mean(0), rtol=0, atol=4 / math.sqrt(size))
    order = angles[:8192, 0]
    assert abs(float(torch.corrcoef(torch.stack([order[:-1], order[1:]]))[0, 1])) < 0.05


@pytest.mark.filterwarnings("ignore:.* times the light")
def test_table_samples_are_measured_values(table: np.ndarray) -> None:
    data = task_of_table("measured", table, 8192, "").data
    bins = merl_index(data["angles"])
    assert len(bins.unique()) == 8192  # nothing held out has been seen
    centres = merl_centres().reshape(-1, 3)[bins]
    turned = data["angles"][:, 2] > math.pi  # the value of phi_d - pi, by reciprocity
    torch.testing.assert_close(data["angles"], centres + turned[:, None] * torch.tensor([0, 0, math.pi]))
    assert float(turned.float().mean()) == pytest.approx(0.5, abs=0.02)
    assert is_above_horizon(data["angles"]).all()
    assert merl_valid_mask(table).reshape(-1)[bins.numpy()].all()
    assert torch.equal(data["reflectance"], torch.from_numpy(table.reshape(-1, 3)[bins.numpy()]).float())
    again = task_of_table("measured", table, 8192, "").data
    assert all(torch.equal(data[key], again[key]) for key in data)


def invalid_but(*bins: slice | int) -> np.ndarray:
    """A table of which these bins alone are valid."""
    table = np.broadcast_to(-CHANNEL_SCALES, (90, 90, 180, 3)).copy()
    table[bins] = 1.0
    return table


@pytest.mark.parametrize(
    ("material", "samples", "message"),
    [
        (evaluate, 1, "x: 1 samples, expected 2 or more"),
        (lambda angles: angles[:, :1], 64, r"x: reflectance \(64, 1\), expected \(64, 3\)"),
        (lambda angles: angles * math.nan, 64, "x: 192 values of the samples are NaN or infinite"),
        (invalid_but(slice(40, 50), slice(10, 20)), 50_000, "x: 18,000 valid bins, expected 50,000 or more"),
        # a sliver that draws hardly ever hit
        (invalid_but(0, 0), 100, r"x: [0-9,]+ valid samples in [0-9,]+ draws, expected 100; take fewer"),
    ],
)
def test_materials_without_samples_are_refused_in_one_line(material: Any, samples: int, message: str) -> None:
    make = task_of_table if isinstance(material, np.ndarray) else make_brdf_task
    with pytest.raises(ValueError, match=message):
        make("x", material, samples=samples, source="x")


def constant_network(folder: Path, reflectance: float) -> Path:
    weights = {part: np.zeros(shape, dtype=np.float32) for part, shape in NBRDF_ARRAY_SHAPES.items()}
    write_nbrdf(folder, weights | {"b3": np.full(3, math.log1p(reflectance), dtype=np.float32)})
    return folder


@pytest.mark.parametrize(
    ("reflectance", "said"),
    [(0.0, "reflectance 0 everywhere"), (1.0, "3.14 times the light"), (1e30, "up to 1e+30 /sr")],
)
def test_conversions_and_fits_warn_once(metapp: Callable, tmp_path: Path, reflectance: float, said: str) -> None:
    folder = constant_network(tmp_path / "gold", reflectance)
    converted = metapp("data", "nbrdf", folder, "--out", tmp_path / "set", "--samples", "64", "--quiet")
    fitted = metapp("overfit", "brdf", folder, "--steps", "1", "--out", tmp_path / "runs", "--quiet")
    for result in (converted, fitted):
        assert result.code == 0
        (line,) = [line for line in result.err.splitlines() if "is it damaged" in line]
        assert line.startswith("warning: ")
        assert said in line
        assert "gold" in line


def test_valid_values_cause_no_warning(tmp_path: Path, write_nbrdf_networks: Callable[[int], Path]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_network(constant_network(tmp_path / "plaster", 0.25), samples=64)
        read_network(write_nbrdf_networks(1) / "m0", samples=64)
