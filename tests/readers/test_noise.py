"""Materials as measurements have them: what is changed, by how much, and what is not."""

from __future__ import annotations

import math

import pytest
import torch

from data_tools.readers.brdf_task import as_measured
from metapp.appearance.geometry import cosines
from metapp.appearance.noise import DECADES
from metapp.learning.task import Task

N = 20_000


@pytest.fixture(scope="module")
def task() -> Task:
    rng = torch.Generator().manual_seed(0)
    angles = torch.rand(2 * N, 3, generator=rng) * torch.tensor([0.7, 0.7, 2 * math.pi])
    return Task("brass", {"angles": angles, "reflectance": 0.1 + torch.rand(2 * N, 3, generator=rng)})


def logs(task: Task, made: Task) -> torch.Tensor:
    return (made.data["reflectance"] / task.data["reflectance"]).double().log()


def test_noise_is_of_the_visible_half_alone(task: Task) -> None:
    made = as_measured(task, 0.2)
    assert torch.equal(made.data["angles"], task.data["angles"])
    assert torch.equal(made.data["reflectance"][N:], task.data["reflectance"][N:])
    found = logs(task, made)[:N]
    assert float(found.std()) == pytest.approx(0.2, rel=0.02)
    assert abs(float(found.mean())) < 0.005
    assert torch.corrcoef(found.T).fill_diagonal_(0).abs().max() < 0.03  # channels are apart
    assert torch.equal(logs(task, as_measured(task, 0.2)), logs(task, made))  # the same again
    assert torch.equal(logs(task, as_measured(task, 0.0)), torch.zeros(2 * N, 3))


def test_few_samples_stand_in_for_all(task: Task) -> None:
    made = as_measured(task, 0.0, samples=64)
    seen, held_out = made.data["angles"].split(N)
    kept = seen.unique(dim=0)
    assert len(kept) == 64
    assert torch.isin(kept, task.data["angles"][:N]).all()
    assert torch.equal(held_out, task.data["angles"][N:])
    assert len(as_measured(task, 0.0, samples=2 * N).data["angles"][:N].unique(dim=0)) == N


def test_outliers_are_off_by_half_a_decade_to_one(task: Task) -> None:
    decades = logs(task, as_measured(task, 0.0, 0.1))[:N] / math.log(10)
    off = decades[:, 0].abs() > 1e-3
    assert float(off.double().mean()) == pytest.approx(0.1, abs=0.01)
    sizes = decades[off].abs()
    assert sizes.min() > DECADES[0] - 1e-4
    assert sizes.max() < DECADES[1] + 1e-4
    assert float((decades[off, 0] > 0).double().mean()) == pytest.approx(0.5, abs=0.05)
    torch.testing.assert_close(decades[:, 0], decades[:, 1], rtol=0, atol=1e-5)


def test_no_sample_is_left_at_grazing_angles(task: Task) -> None:
    limit = math.radians(60)
    made = as_measured(task, 0.0, grazing_rad=limit)
    before, after = (cosines(each.data["angles"]) for each in (task, made))
    assert min(after.incident[:N].min(), after.outgoing[:N].min()) > math.cos(limit) - 1e-6
    stay = torch.minimum(before.incident, before.outgoing)[:N] > math.cos(limit)
    assert torch.equal(made.data["angles"][:N][stay], task.data["angles"][:N][stay])
    assert torch.equal(made.data["angles"][N:], task.data["angles"][N:])
    # what stands for a missing sample is a whole sample of the visible half
    known = {tuple(row) for row in torch.cat([task.data["angles"], task.data["reflectance"]], 1)[:N].tolist()}
    assert {tuple(row) for row in torch.cat([made.data["angles"], made.data["reflectance"]], 1)[:N].tolist()} <= known


def test_a_material_without_any_sample_left(task: Task) -> None:
    steep = task._replace(data=task.data | {"angles": torch.full((2 * N, 3), 0.7)})
    with pytest.raises(ValueError, match=r"^brass: no sample within 1 degrees of the normal, expected some; raise"):
        as_measured(steep, 0.0, grazing_rad=math.radians(1))
