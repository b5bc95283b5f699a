"""Materials as measured: what fits see has noise and gaps, what judges them has not."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Generator, Tensor

from metapp.appearance.geometry import cosines, half_difference
from metapp.apps.brdf import MEASURED_RAD, NOISE, Brdf, measured
from metapp.apps.brdf.featured import Featured
from metapp.learning.task import Params, Tasks

APP = Brdf()

COUNT, HALF = 256, 400


@pytest.fixture
def data() -> Params:
    """One grey material COUNT times, at the same angles above the horizon."""
    rng = Generator().manual_seed(5)
    high = torch.tensor([math.pi / 2, math.pi / 2, 2 * math.pi])
    angles = torch.rand(40 * HALF, 3, generator=rng, dtype=torch.float64) * high
    at = cosines(angles)
    kept = torch.minimum(at.incident, at.outgoing) > 0.01
    angles = angles[kept][: 2 * HALF]
    where = torch.cat([half_difference(angles), cosines(angles).incident[:, None]], 1).float()
    target = torch.log1p(0.3 * where[:, 6:]).expand(-1, 3)
    return {"where": where.expand(COUNT, -1, -1), "target": target.expand(COUNT, -1, -1)}


def lower(where: Tensor) -> Tensor:
    half, other = where[..., :3], where[..., 3:6]
    incident = other[..., 2] * half[..., 2] - other[..., 0] * half[..., 0]
    return torch.minimum(incident, other[..., 2] * half[..., 2] + other[..., 0] * half[..., 0])


def test_the_half_that_judges_is_as_it_was(data: Params, rng: Generator) -> None:
    made = measured(data, rng)
    for key, value in made.items():
        assert value.shape == data[key].shape
        assert torch.equal(value[:, HALF:], data[key][:, HALF:])


def test_some_materials_are_noisy(data: Params, rng: Generator) -> None:
    """Half of them by up to NOISE; the others have not changed where their samples stand."""
    made = measured(data, rng)
    expected = 0.3 * made["where"][:, :HALF, 6:]
    spread = (torch.expm1(made["target"][:, :HALF]) / expected).log().flatten(1).abs().median(1).values / 0.6745
    assert 0.35 < float((spread < 1e-5).float().mean()) < 0.65
    assert 0.8 * NOISE < float(spread.max()) < 1.2 * NOISE


def test_some_materials_lack_grazing_samples(data: Params, rng: Generator) -> None:
    least = lower(measured(data, rng)["where"][:, :HALF]).amin(1)
    whole = lower(data["where"][:1, :HALF]).min()
    cut = least > whole + 1e-6
    assert 0.2 < float(cut.float().mean()) < 0.47
    assert float(least[cut].min()) > math.cos(MEASURED_RAD[1]) - 1e-6
    assert float(least.max()) < math.cos(MEASURED_RAD[0]) + 0.02


def test_only_the_recipe_for_it_learns_from_measurements(data: Params) -> None:
    """The other one's augmented materials stay grey, but for one factor a channel."""
    tasks = Tasks(tuple(map(str, range(COUNT))), data, torch.arange(COUNT))
    spreads = []
    for app in (APP, Brdf(Featured()), Brdf(Featured(measured=True))):
        made = app.augment(tasks.select(range(16)), Generator().manual_seed(1)).data
        half = made["where"].shape[1] // 2
        factor = torch.expm1(made["target"][:, :half]) / made["where"][:, :half, 6:]
        spreads.append(float((factor.std(1) / factor.mean(1)).max()))
    assert max(spreads[:2]) < 1e-3 < 0.05 < spreads[2]


def test_outer_losses_are_of_the_half_that_fits_do_not_see(data: Params, rng: Generator) -> None:
    tasks = Tasks(tuple(map(str, range(COUNT))), data, torch.arange(COUNT)).select([0])
    seen = {tuple(row) for row in data["where"][0, :HALF].tolist()}
    inner, outer = (draw(tasks, rng, 64)["where"][0].T.tolist() for draw in (APP.sample, APP.outer_sample))
    assert all(tuple(row) in seen for row in inner)
    assert not any(tuple(row) in seen for row in outer)
