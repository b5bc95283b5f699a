"""Baselines of BRDFs, by what their fits must be: minima of the cost that they name, and inverses of what they fit."""

from __future__ import annotations

import itertools
import math

import pytest
import torch
from torch import Generator, Tensor

from metapp.appearance.geometry import cosines
from metapp.apps.brdf.app import Brdf
from metapp.extensions.baselines import lobes
from metapp.extensions.baselines.baseline import Allowed, Training
from metapp.extensions.baselines.brdf import PENALTIES, SOLVES, _components, components_of, drawn, mean_error, ridge_in
from metapp.extensions.baselines.components import DELTA, EPSILON, Components
from metapp.learning.app import stack
from metapp.learning.task import Tasks
from metapp.paradigms.validation import split_validation
from tests.extensions.baselines.test_brdf_baselines import ONE, random_materials

APP = Brdf()


@pytest.fixture
def materials(rng: Generator) -> Tasks:
    """Twelve, in double precision."""
    made = stack(APP, random_materials(12, rng))
    where, target = made.data["where"][0].double(), made.data["target"].double()
    return Tasks(made.names, {"where": where.expand(12, -1, -1), "target": target}, made.rows)


def test_the_mapping_is_the_published_one() -> None:
    """Nielsen et al. 2015: the log of (rho w + 0.001) / (rho_0 w + 0.001)."""
    one = torch.ones(1, 1)
    of = Components(one, torch.tensor([[0.5]]), torch.tensor([[0.2]]), one, one, one)
    assert of.mapped(torch.tensor([[0.0, 2.0]]))[0].tolist() == pytest.approx(
        [math.log(0.001 / 0.101), math.log(1.001 / 0.101)]
    )


def test_places_are_weighted_by_both_cosines(rng: Generator) -> None:
    task = random_materials(1, rng)[0]
    prepared = APP.prepare(task)
    found = components_of(prepared["where"], prepared["target"].expand(4, -1, -1))
    of = cosines(task.data["angles"].double())
    expected = (of.incident * of.outgoing).clamp_min(EPSILON)
    torch.testing.assert_close(found.weight[:, 0].double(), expected, atol=1e-6, rtol=1e-4)


@pytest.mark.parametrize("solves", [1, 2, 3])
def test_coefficients_are_at_the_minimum_of_their_cost(materials: Tasks, rng: Generator, solves: int) -> None:
    """Squares of log-relative residuals, weighted by the slope of the table's error and by its size before."""
    where, target = materials.data["where"][0], materials.data["target"]
    rows, seen = drawn(materials.select([10]), rng, 300)  # which is not in the span
    used, penalty = components_of(where, target[:8]).first(5).at(rows), 1e-3
    reflectance = (seen.expm1() / used.cos).requires_grad_()
    mapped = used.mapped(reflectance)
    (by_reflectance,) = torch.autograd.grad(torch.log1p(reflectance * used.cos).sum(), reflectance)
    (mapped_by,) = torch.autograd.grad(mapped.sum(), reflectance)
    weights = slope = by_reflectance / mapped_by
    if solves > 1:
        before = used.reflectance(used.coefficients(seen, penalty, solves - 1))
        error = (torch.log1p(before * used.cos) - seen).abs()
        weights = slope**2 / (error + DELTA * error.mean(0))
    found = used.coefficients(seen, penalty, solves).requires_grad_()
    residual = used.axes @ found + used.mean - mapped.detach()
    drawn_to = (found / used.deviation[:, None]) ** 2
    cost = (weights / weights.mean(0) * residual**2).sum() + penalty * len(residual) * drawn_to.sum()
    (gradient,) = torch.autograd.grad(cost, found)
    assert gradient.abs().max() < 1e-8 * cost.item() + 1e-8


def test_a_penalty_is_judged_on_materials_that_components_do_not_know(rng: Generator) -> None:
    training, allowed = Training(APP, random_materials(12, rng)), Allowed(200, 2700)
    known, validation = split_validation(training.stacked)
    where = known.data["where"][0]
    components = components_of(where, known.data["target"][known.rows]).first(4)
    settings = itertools.product(PENALTIES, SOLVES)
    errors = {each: mean_error(APP, ridge_in(where, components, *each), validation, allowed) for each in settings}
    penalty, solves = min(errors, key=errors.__getitem__)
    assert _components(4, training, allowed).chosen == {"penalty": penalty, "solves": solves}


def near_mirror(rng: Generator, count: int = 3000) -> lobes.Cosines:
    """Angles of which half have the half vector within two degrees of the normal."""
    high = torch.tensor([1.3, 1.2, 2 * math.pi], dtype=torch.float64)
    angles = torch.rand(count, 3, generator=rng, dtype=torch.float64) * high
    angles[::2, 0] *= 0.03
    of = cosines(angles)
    above = (of.incident > 0.05) & (of.outgoing > 0.05)
    return lobes.Cosines(*(cosine[above] for cosine in of))


def lobe(alpha: float) -> Tensor:
    return torch.tensor([0.3, 0.05, 0.6, math.log(alpha), 0.04, 0.5, 0.8, 0.2], dtype=torch.float64)


def samples_of(numbers: Tensor, at: lobes.Cosines) -> tuple[lobes.Cosines, Tensor]:
    return (at, torch.log1p(lobes.reflectance(numbers, at) * at.incident[:, None]))


@pytest.mark.parametrize("alpha", [0.03, 0.12, 0.4])
def test_a_descent_begins_at_the_colours_of_a_material_of_its_alphas(rng: Generator, alpha: float) -> None:
    at = near_mirror(rng)
    first = torch.from_numpy(lobes._first(*samples_of(lobe(alpha), at), (alpha,)))
    torch.testing.assert_close(first, lobe(alpha), atol=2e-4, rtol=1e-6)


@pytest.mark.parametrize("alpha", [0.006, 0.02, 1.2])
def test_lobes_from_nearly_a_mirror_to_nearly_none_are_recovered(rng: Generator, alpha: float) -> None:
    found = lobes.fit(*samples_of(lobe(alpha), near_mirror(rng)), ONE)
    assert found[3].exp().item() == pytest.approx(alpha, rel=0.05)


def test_alphas_stay_in_their_bounds(rng: Generator) -> None:
    at = near_mirror(rng)
    for alpha in (0.001, 4.0):
        found = lobes.fit(*samples_of(lobe(alpha), at), ONE)
        assert 0.005 * (1 - 1e-9) <= found[3].exp().item() <= 1.5 * (1 + 1e-9)
        assert 0 <= found[4] <= 1
        assert found[[0, 1, 2, 5, 6, 7]].min() >= 0
