"""Baselines of BRDFs, components of log-relative BRDFs and GGX lobes: minima of their costs, inverses of materials."""

import itertools
import math
from collections.abc import Callable

import pytest
import torch
from torch import Generator, Tensor

from metapp.appearance.geometry import angle_cosines
from metapp.appearance.reflection import fresnel_schlick, microfacet_lobe
from metapp.apps.brdf.app import Brdf
from metapp.extensions.baselines import ggx_lobes
from metapp.extensions.baselines.baseline import CostLimits, TrainingTasks
from metapp.extensions.baselines.brdf import (
    CANDIDATE_PENALTIES,
    CANDIDATE_SOLVES,
    Pca,
    baselines,
    cosines_at_places,
    draw_seen_rows,
    mean_error,
    task_places,
    training_components,
)
from metapp.extensions.baselines.components import (
    MIN_ERROR_SHARE,
    REFLECTANCE_EPSILON,
    Components,
    principal_components,
    solve_weighted_ridge,
)
from metapp.learning.app import stack_tasks
from metapp.learning.task import Task, Tasks
from metapp.paradigms.training import split_validation

APP = Brdf()

SAMPLES = 600
ONE = ((0.03,), (0.12,), (0.4,))  # alphas at which fits of one lobe begin


def random_materials(count: int, rng: Generator, apart: bool = False) -> list[Task]:
    """Sums of a few smooth lobes at the same angles, or each at its own."""

    def angles() -> torch.Tensor:
        high = torch.tensor([0.7, 0.7, 2 * math.pi])
        return torch.rand(SAMPLES, 3, generator=rng) * high

    common, tasks = angles(), []
    for i in range(count):
        at = angles() if apart else common
        body, gloss, width = torch.rand(3, 3, generator=rng).unbind()
        lobe = torch.exp(-(at[:, :1] ** 2) / (0.05 + width))
        tasks.append(Task(f"m{i}", {"angles": at, "reflectance": body + 3 * gloss * lobe}))
    return tasks


def test_the_mapping_is_the_published_one_and_has_an_inverse(rng: Generator) -> None:
    """Nielsen et al. 2015: the log of (rho w + 0.001) / (rho_0 w + 0.001)."""
    ones = torch.ones(1, 1)
    of = Components(ones, torch.tensor([[0.5]]), torch.tensor([[0.2]]), ones, ones, ones)
    expected = [math.log(0.001 / 0.101), math.log(1.001 / 0.101)]
    assert of.log_relative_reflectance(torch.tensor([[0.0, 2.0]]))[0].tolist() == pytest.approx(expected)
    reflectance = torch.rand(50, 4, generator=rng) * 10
    reflectance[0] = 0
    cos, weight, reference = (torch.rand(50, 1, generator=rng) + 0.01 for _ in range(3))
    of = Components(cos, weight, reference, torch.zeros(50, 1), torch.eye(50), torch.ones(50))
    torch.testing.assert_close(
        of.reflectance(of.log_relative_reflectance(reflectance)), reflectance, atol=1e-5, rtol=1e-4
    )
    assert torch.equal(of.log_relative_reflectance(reference.expand(-1, 4)), torch.zeros(50, 4))


def test_components_are_those_of_the_singular_value_decomposition(rng: Generator) -> None:
    columns = torch.randn(300, 9, generator=rng, dtype=torch.float64) * torch.linspace(1, 4, 9)
    _, axes, deviation = principal_components(columns, 5)
    centred = columns - columns.mean(1, keepdim=True)
    left, values, _ = torch.linalg.svd(centred, full_matrices=False)
    assert torch.allclose(axes.T @ axes / 300, torch.eye(5, dtype=torch.float64), atol=1e-9)
    torch.testing.assert_close(deviation, values[:5] / math.sqrt(300 * 9))
    assert torch.allclose((left[:, :5].T @ axes).abs() / math.sqrt(300), torch.eye(5, dtype=torch.float64), atol=1e-9)
    few = torch.randn(40, 4, generator=rng, dtype=torch.float64)
    for unit in (1e-4, 1, 1e4):
        assert principal_components(unit * few, 20)[1].shape == (40, 3)  # and a mean


def test_samples_and_cosines_are_those_of_the_application(rng: Generator) -> None:
    # in one draw what ten steps draw of one task
    one = stack_tasks(APP, random_materials(12, rng)).select([3])
    rng = Generator().manual_seed(5)
    steps = [APP.sample(one, rng, 64) for _ in range(10)]
    rows, target = draw_seen_rows(one, Generator().manual_seed(5), 640)
    assert torch.equal(torch.cat([batch["where"][0] for batch in steps], 1).T, task_places(one)[rows])
    assert torch.equal(torch.cat([batch["target"][0] for batch in steps], 1).T, target)
    assert rows.max() < SAMPLES // 2
    task = random_materials(1, Generator().manual_seed(3))[0]
    prepared = APP.prepare(task)
    for found, expected in zip(
        cosines_at_places(prepared["where"]), angle_cosines(task.data["angles"].double()), strict=True
    ):
        torch.testing.assert_close(found, expected, atol=1e-6, rtol=1e-5)


def test_places_are_weighted_by_both_cosines(rng: Generator) -> None:
    task = random_materials(1, rng)[0]
    prepared = APP.prepare(task)
    found = training_components(prepared["where"], prepared["target"].expand(4, -1, -1))
    of = angle_cosines(task.data["angles"].double())
    expected = (of.incident * of.outgoing).clamp_min(REFLECTANCE_EPSILON)
    torch.testing.assert_close(found.weight[:, 0].double(), expected, atol=1e-6, rtol=1e-4)


@pytest.mark.parametrize("solves", [1, 2, 3])
def test_coefficients_are_at_the_minimum_of_their_cost(rng: Generator, solves: int) -> None:
    """Squares of log-relative residuals, weighted by the slope of the table's error and by its size before."""
    result = stack_tasks(APP, random_materials(12, rng))
    where, target = result.data["where"][0].double(), result.data["target"].double()
    materials = Tasks(result.names, {"where": where.expand(12, -1, -1), "target": target}, result.rows)
    rows, seen = draw_seen_rows(materials.select([10]), rng, 300)  # which is not in the span
    used, penalty = training_components(where, target[:8]).select_components(5).select_places(rows), 1e-3
    reflectance = (seen.expm1() / used.cos).requires_grad_()
    mapped = used.log_relative_reflectance(reflectance)
    (by_reflectance,) = torch.autograd.grad(torch.log1p(reflectance * used.cos).sum(), reflectance)
    (mapped_by,) = torch.autograd.grad(mapped.sum(), reflectance)
    weights = slope = by_reflectance / mapped_by
    if solves > 1:
        before = used.reflectance(used.solve_coefficients(seen, penalty, solves - 1))
        error = (torch.log1p(before * used.cos) - seen).abs()
        weights = slope**2 / (error + MIN_ERROR_SHARE * error.mean(0))
    found = used.solve_coefficients(seen, penalty, solves).requires_grad_()
    residual = used.axes @ found + used.mean - mapped.detach()
    drawn_to = (found / used.deviation[:, None]) ** 2
    cost = (weights / weights.mean(0) * residual**2).sum() + penalty * len(residual) * drawn_to.sum()
    (gradient,) = torch.autograd.grad(cost, found)
    assert gradient.abs().max() < 1e-8 * cost.item() + 1e-8


@pytest.mark.parametrize("weighted", [False, True])
def test_ridge_of_fewer_samples_than_axes(rng: Generator, weighted: bool) -> None:
    """Rounding in single precision hides that the system is definite; the answer is that of least squares."""
    rows = torch.randint(8, (800,), generator=rng)
    axes, targets = torch.randn(8, 30, generator=rng)[rows], torch.randn(8, 3, generator=rng)[rows]
    weights = 0.5 + torch.rand(800, 3, generator=rng) if weighted else torch.ones(800, 3)
    deviation, penalty = torch.linspace(2, 0.5, 30), 1e-7
    for channel in range(3):
        root = weights[:, channel : channel + 1].double().sqrt()
        a = torch.cat([root * axes.double(), torch.diag(math.sqrt(penalty) / deviation.double())])
        b = torch.cat([root * targets[:, channel : channel + 1].double(), torch.zeros(30, 1, dtype=torch.float64)])
        found = solve_weighted_ridge(
            axes, targets[:, channel], weights[:, channel], penalty / deviation.double().square()
        )
        expected = torch.linalg.lstsq(a, b, driver="gelsd").solution[:, 0]
        torch.testing.assert_close(found.double(), expected, atol=1e-5, rtol=1e-4)


def test_the_penalty_is_chosen_on_materials_that_components_do_not_know_and_bytes_are_counted(rng: Generator) -> None:
    training, allowed = TrainingTasks(APP, random_materials(12, rng)), CostLimits(400, 2700)
    pca = Pca(APP, 8)
    pca.prepare(training, allowed)
    known, validation = split_validation(training.prepared_tasks)
    where, errors = known.data["where"][0], {}
    components = training_components(where, known.data["target"][known.rows]).select_components(8)
    for setting in itertools.product(CANDIDATE_PENALTIES, CANDIDATE_SOLVES):
        errors[setting] = mean_error(pca_of(where, components, *setting), validation, allowed)
    penalty, solves = min(errors, key=errors.__getitem__)
    assert pca.chosen == {"penalty": penalty, "solves": solves}
    assert pca.shared_bytes == 4 * SAMPLES * (8 + 2)  # components, their mean, and the reference
    one = training.prepared_tasks.select([2])
    fitted = pca.fit(one, Generator().manual_seed(0), allowed)
    assert (fitted.kept_numbers, fitted.kept_bytes) == (24, 96)
    assert APP.errors_of(fitted.prediction(), one)["error"].item() < 0.01
    (named,) = [baseline for baseline in baselines(APP) if baseline.name == "pca_20"]
    named.prepare(training, allowed)
    assert named.fit(one, rng, allowed).kept_numbers == 30  # all that vary by more than rounding


def pca_of(where: Tensor, components: Components, penalty: float, solves: int) -> Pca:
    """Components that are known."""
    pca = Pca(APP, components.axes.shape[1])
    pca.where, pca.components, pca.penalty, pca.solves = where, components, penalty, solves
    return pca


def test_only_materials_at_the_same_angles_are_fitted(rng: Generator) -> None:
    allowed, pca = CostLimits(100, 2700), Pca(APP, 4)
    with pytest.raises(ValueError, match="angles of their own"):
        pca.prepare(TrainingTasks(APP, random_materials(8, rng, apart=True)), allowed)
    pca.prepare(TrainingTasks(APP, random_materials(8, rng)), allowed)
    other = stack_tasks(APP, random_materials(1, rng))
    with pytest.raises(ValueError, match="other angles"):
        pca.fit(other, rng, allowed).prediction()
    materials, half = random_materials(12, rng), SAMPLES // 2
    known = stack_tasks(APP, materials).data
    where = known["where"][0]
    pca = pca_of(where, training_components(where, known["target"]).select_components(8), 1e-9, 1)
    order = torch.cat([torch.randint(half // 4, (half,), generator=rng), torch.arange(half, SAMPLES)])
    moved = materials[3]._replace(data={key: value[order] for key, value in materials[3].data.items()})
    one = stack_tasks(APP, [moved])
    assert APP.errors_of(pca.fit(one, rng, CostLimits(400, 2700)).prediction(), one)["error"].item() < 0.01


@pytest.fixture
def at(random_angles: Callable[..., Tensor]) -> ggx_lobes.Cosines:
    return angle_cosines(random_angles(3000))


def seen(numbers: Tensor, at: ggx_lobes.Cosines) -> tuple[ggx_lobes.Cosines, Tensor]:
    return (at, torch.log1p(ggx_lobes.lobes_reflectance(numbers, at) * at.incident[:, None]))


def test_a_lobe_is_that_of_the_microfacet_model(at: ggx_lobes.Cosines) -> None:
    numbers = torch.tensor([0.3, 0.2, 0.1, math.log(0.2), 0.04, 1.0, 1.0, 1.0], dtype=torch.float64)
    expected = microfacet_lobe(at, 0.2, lambda cos: fresnel_schlick(cos, 0.04)) + numbers[:3] / math.pi
    torch.testing.assert_close(ggx_lobes.lobes_reflectance(numbers, at), expected)


def test_slopes_are_those_of_finite_differences(at: ggx_lobes.Cosines) -> None:
    numbers = torch.tensor([0.3, 0.2, 0.1, math.log(0.2), 0.04, 1.0, 0.7, 0.4, math.log(0.5), 0.3, 0.2, 0.1, 0.6])
    numbers, step = numbers.double(), 1e-6
    found = ggx_lobes.lobes_jacobian(numbers, at)
    for i, unit in enumerate(torch.eye(len(numbers), dtype=torch.float64)):
        above, below = (ggx_lobes.lobes_reflectance(numbers + sign * step * unit, at) for sign in (1, -1))
        torch.testing.assert_close(found[..., i], (above - below) / (2 * step), atol=1e-7, rtol=1e-5)


def near_mirror(rng: Generator, count: int = 3000) -> ggx_lobes.Cosines:
    """Angles of which half have the half vector within two degrees of the normal."""
    high = torch.tensor([1.3, 1.2, 2 * math.pi], dtype=torch.float64)
    angles = torch.rand(count, 3, generator=rng, dtype=torch.float64) * high
    angles[::2, 0] *= 0.03
    of = angle_cosines(angles)
    above = (of.incident > 0.05) & (of.outgoing > 0.05)
    return ggx_lobes.Cosines(*(cosine[above] for cosine in of))


@pytest.mark.parametrize("alpha", [0.006, 0.02, 0.05, 0.3, 1.2])
def test_lobes_fit_their_own_materials(at: ggx_lobes.Cosines, rng: Generator, alpha: float) -> None:
    """From nearly a mirror to nearly none."""
    usual, numbers = 0.05 <= alpha <= 0.3, torch.tensor([0.3, 0.05, 0.6, math.log(alpha), 0.1, 0.5, 0.8, 0.2]).double()
    found = ggx_lobes.fit_ggx_lobes(*seen(numbers, at if usual else near_mirror(rng)), ONE)
    if usual:
        torch.testing.assert_close(found, numbers, atol=0.01, rtol=0.01)
    assert found[3].exp().item() == pytest.approx(alpha, rel=0.05)


def test_two_lobes_fit_materials_that_one_does_not(at: ggx_lobes.Cosines) -> None:
    wide, narrow = [math.log(0.4), 0.05, 0.9, 0.5, 0.4], [math.log(0.06), 0.04, 0.3, 0.3, 0.3]
    target = seen(torch.tensor([0.1, 0.2, 0.05, *wide, *narrow], dtype=torch.float64), at)
    errors = [
        (seen(ggx_lobes.fit_ggx_lobes(*target, alphas), at)[1] - target[1]).abs().mean().item()
        for alphas in (ONE, ggx_lobes.INITIAL_ALPHAS)
    ]
    assert errors[1] < 2e-4
    assert errors[1] < 0.1 * errors[0]


def test_alphas_stay_in_their_bounds(rng: Generator) -> None:
    at = near_mirror(rng)
    for alpha in (0.001, 4.0):
        numbers = torch.tensor([0.3, 0.05, 0.6, math.log(alpha), 0.04, 0.5, 0.8, 0.2], dtype=torch.float64)
        found = ggx_lobes.fit_ggx_lobes(*seen(numbers, at), ONE)
        assert 0.005 * (1 - 1e-9) <= found[3].exp().item() <= 1.5 * (1 + 1e-9)
        assert 0 <= found[4] <= 1
        assert found[[0, 1, 2, 5, 6, 7]].min() >= 0
