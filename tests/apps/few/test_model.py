"""The Gaussian model of BRDFs for few samples: closed forms, what samples leave open, which directions tell most."""

import math

import pytest
import torch
from torch import Generator, Tensor

from data_tools.readers.brdf_task import make_brdf_task
from metapp.appearance.geometry import directions_to_full_rusinkiewicz
from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.brdf_network import DistinctSamples, opponent_axes
from metapp.apps.brdf.feature_network import isotropic_inputs
from metapp.apps.brdf.few.app import MAX_FEW_SAMPLES, TABLE_SAMPLES, TRAINING_SAMPLE_RANGE, FewSamples
from metapp.apps.brdf.few.design import InstrumentLimits, Posterior, expected_errors, places_at_angles, plan_directions
from metapp.apps.brdf.few.gaussian_model import (
    DARKEST_REFLECTANCE,
    Few,
    cosine_product,
    error_slope,
    log_evidence,
    model_features,
    model_reflectance,
    ridge_regression,
    sample_precision,
)
from metapp.learning.app import stack_tasks
from metapp.learning.task import Params, Tasks

APP = FewSamples(Few(width=12, features=7))
NOTHING = torch.zeros(0, 3)


@pytest.fixture
def theta() -> Params:
    """A model whose materials differ, in double precision."""
    rng = Generator().manual_seed(1)
    one = {key: value.double() for key, value in APP.init(rng, 1).items()}
    last = 0.1 * torch.randn(1, 3, 8, generator=rng, dtype=torch.float64)
    last[:, 0, -1] = -3
    return one | {"last": last, "deviation": one["deviation"] + torch.randn(1, 3, 8, generator=rng).double() / 4}


@pytest.fixture
def where() -> Tensor:
    return places_at_angles(angles_of(40).double())


def angles_of(count: int, seed: int = 2) -> Tensor:
    draws = torch.rand(40 * count, 3, generator=Generator().manual_seed(seed))
    draws = draws * torch.tensor([math.pi / 2, math.pi / 2, 2 * math.pi])
    above = places_at_angles(draws)
    return draws[(above[0, 6] > 0.05) & (cosine_product(above)[0, 0] > 0.05)][:count]


def samples_of(theta: Params, where: Tensor) -> DistinctSamples:
    """Samples of a material that the model draws."""
    change = torch.randn(theta["last"].shape, generator=Generator().manual_seed(3), dtype=torch.float64)
    drawn = theta | {"last": theta["last"] + theta["deviation"].exp() * change}
    target = torch.log1p(model_reflectance(drawn, where).clamp_min(0) * where[:, 6:])
    return DistinctSamples(where, target, torch.tensor([float(where.shape[2])], dtype=torch.float64))


def test_opponent_axes_are_orthonormal(theta: Params) -> None:
    axes = opponent_axes(theta["last"])
    torch.testing.assert_close(axes.T @ axes, torch.eye(3).double())
    torch.testing.assert_close(axes[:, 0], torch.full((3,), 3**-0.5).double())  # luminance; the others have no gray
    torch.testing.assert_close(axes[:, 1:].sum(0), torch.zeros(2).double())


def test_the_slope_is_that_of_finite_differences(where: Tensor) -> None:
    f = torch.rand(1, 3, where.shape[2], generator=Generator().manual_seed(4)).double() * 3
    logs, step = (f * cosine_product(where) + DARKEST_REFLECTANCE).log(), 1e-6

    def error(logs: Tensor) -> Tensor:
        return torch.log1p((logs.exp() - DARKEST_REFLECTANCE) / cosine_product(where) * where[:, 6:7])

    expected = (error(logs + step) - error(logs - step)) / (2 * step)
    torch.testing.assert_close(error_slope(f, where), expected, rtol=1e-6, atol=1e-9)


def test_a_solve_is_ridge_regression_in_logarithms(theta: Params, where: Tensor) -> None:
    """A least-squares solver on augmented rows agrees; the covariance is the inverse of the normal equations."""
    samples = samples_of(theta, where)
    at = ridge_regression(theta, samples)
    seen = samples.target.expm1() / where[:, 6:7]
    logs = opponent_axes(theta["last"]).T @ (seen * cosine_product(where) + DARKEST_REFLECTANCE).log()
    features, weights = model_features(theta, where)[0], sample_precision(theta, error_slope(seen, where))[0]
    torch.testing.assert_close(at.weights[0], weights * where.shape[2])
    posterior = Posterior.from_samples(theta, where, error_slope(seen, where))
    for axis in range(3):
        root = weights.sqrt()
        rows = torch.cat([(features * root).T, torch.diag(torch.exp(-theta["deviation"][0, axis]))])
        expected = (logs[0, axis] - theta["last"][0, axis] @ features) * root
        change = torch.linalg.lstsq(rows, torch.cat([expected, torch.zeros(8).double()])[:, None]).solution[:, 0]
        gram = at.features[0] * at.weights[0] / where.shape[2] @ at.features[0].T + torch.diag(at.prior[0, axis])
        moment = at.features[0] * at.weights[0] / where.shape[2] @ at.residual[0, axis]
        torch.testing.assert_close(torch.linalg.solve(gram, moment), change)
        torch.testing.assert_close(posterior.covariance[axis], torch.linalg.inv(rows.T @ rows))


def _like(theta: Params) -> Params:
    """Another model with the same features."""
    changes = {"last": 0.2, "deviation": -0.3, "noise": 0.4}
    return theta | {key: theta[key] + change for key, change in changes.items()}


def test_evidence_agrees_with_the_likelihood_of_samples(theta: Params, where: Tensor) -> None:
    """Differences between models are those of the normal distributions of the logarithms, written out."""
    samples, logs = samples_of(theta, where), []
    for model in (theta, _like(theta)):
        features = model_features(model, where)[0]
        weights = sample_precision(model, error_slope(samples.target.expm1() / where[:, 6:7], where))[0]
        at = ridge_regression(model, samples).residual[0]
        spread = model["deviation"][0].exp().square()
        covariances = torch.einsum("fn,cf,fm->cnm", features, spread, features) + torch.diag(1 / weights)
        normal = torch.distributions.MultivariateNormal(torch.zeros_like(at), covariances)
        logs.append((log_evidence(model, samples)[0], normal.log_prob(at).sum()))
    (first, expected), (second, other) = logs
    torch.testing.assert_close(first - second, expected - other)


def test_samples_select_the_kind_of_material(theta: Params, where: Tensor) -> None:
    rng, size = Generator().manual_seed(6), Few(width=12, features=7, kinds=3)
    encoder = {key: value.double() for key, value in size.init_encoder(rng).items()}
    encoder["encoder.last"] = 0.5 * torch.randn(3, 3, 8, generator=rng).double()
    encoder["encoder.deviation"] -= torch.tensor([0.0, 0.5, 1.0])[:, None, None].double()
    models = [size.select_kinds(encoder, torch.tensor([kind])) for kind in range(3)]
    samples = [samples_of(model, where) for model in models]
    batch = {key: torch.cat([getattr(single, key) for single in samples]) for key in DistinctSamples._fields}
    found = size.encode(encoder, batch)
    assert torch.equal(found["last"], encoder["encoder.last"])
    assert found["w1"].shape == (3, 12, 15)


def test_deviations_are_those_of_materials_that_the_model_draws(theta: Params, where: Tensor) -> None:
    posterior = Posterior.from_samples(theta, where[:, :, :5])
    rng = Generator().manual_seed(5)
    roots = torch.linalg.cholesky(posterior.covariance)
    draws = torch.einsum("cfg,cgn->cfn", roots, torch.randn(3, 8, 20_000, generator=rng, dtype=torch.float64))
    axes = opponent_axes(theta["last"])
    logs = axes @ torch.einsum("cfn,fm->mcn", draws, model_features(theta, where)[0])  # [M, 3, draws]
    torch.testing.assert_close(posterior.log_deviation(where), logs.std(2).T, rtol=0.03, atol=1e-5)


def test_more_samples_never_raise_the_uncertainty(theta: Params, where: Tensor) -> None:
    before = Posterior.from_samples(theta, where[:, :, :0]).log_deviation(where)
    for count in (1, 4, 16):
        after = Posterior.from_samples(theta, where[:, :, :count]).log_deviation(where)
        assert bool((after <= before + 1e-12).all())
        before = after


def test_linear_layers_agree_with_the_network(theta: Params, where: Tensor) -> None:
    single = {key: value[0] for key, value in theta.items()}
    x = isotropic_inputs(where)[0]
    for weights, bias in (layers := APP.network.fold(single).layers)[:2]:
        x = torch.nn.functional.silu(weights @ x + bias[:, None])
    x = layers[2][0] @ x + layers[2][1][:, None]
    torch.testing.assert_close(
        (x.exp() - DARKEST_REFLECTANCE) / cosine_product(where)[0], APP.network.reflectance(theta, where)[0]
    )


# What a fit sees


@pytest.mark.usefixtures("small_spheres")
def test_a_table_is_seen_by_its_first_samples_and_a_cut_one_by_all_it_has() -> None:
    task = make_brdf_task("gray", lambda angles: torch.full((*angles.shape[:-1], 3), 0.2), samples=4096)
    data = Brdf().prepare(task)
    assert float(APP.prepare(task)["distinct"]) == TABLE_SAMPLES
    rows = torch.arange(2048) % 40 + 100
    cut = {key: torch.cat([task.data[key][rows], task.data[key][2048:]]) for key in ("angles", "reflectance")}
    found = APP.prepare(task._replace(data=cut))
    assert float(found["distinct"]) == 40
    assert torch.equal(found["where"][:40].unique(dim=0), data["where"][100:140].unique(dim=0))
    assert torch.equal(found["where"][2048:], data["where"][2048:])
    batch = APP.sample(stack_tasks(APP, [task]), Generator(), MAX_FEW_SAMPLES)
    assert len(batch["where"][0].T.unique(dim=0)) == TABLE_SAMPLES


def test_training_draws_few_samples_of_each_material() -> None:
    where = places_at_angles(angles_of(2000)).expand(6, -1, -1).transpose(1, 2)
    tasks = Tasks(tuple("abcdef"), {"where": where, "target": torch.rand(6, 2000, 3)}, torch.arange(6))
    data = APP.augment(tasks, Generator().manual_seed(0)).data
    least, greatest = TRAINING_SAMPLE_RANGE
    assert bool(((data["distinct"] >= least) & (data["distinct"] <= greatest)).all())
    assert len(data["distinct"].unique()) > 1


# Plans


def test_planned_directions_lie_within_the_limits_of_the_instrument(theta: Params) -> None:
    single = {key: value.float() for key, value in theta.items()}
    for limits in (
        InstrumentLimits(),
        InstrumentLimits(math.radians(50), math.radians(20)),
        InstrumentLimits(detector_rad=math.radians(30)),
    ):
        wi, wo = plan_directions(single, 6, limits, NOTHING, Generator().manual_seed(0))
        assert wi.shape == wo.shape == (6, 3)
        torch.testing.assert_close(torch.cat([wi, wo]).norm(dim=1), torch.ones(12))
        assert bool(limits.allow(wi, wo).all())
        if limits.detector_rad:
            torch.testing.assert_close(wo[:, 2], torch.full((6,), math.cos(limits.detector_rad)))
    with pytest.raises(ValueError, match="0 of 4096 pairs of directions within the limits, expected 6"):
        plan_directions(single, 6, InstrumentLimits(detector_rad=math.radians(85)), NOTHING, Generator())


def test_planned_directions_tell_more_than_random_ones(theta: Params) -> None:
    """The second half of a plan follows on what was measured and differs from the first half."""
    single = {key: value.float() for key, value in theta.items()}

    def left(angles: Tensor) -> float:
        return expected_errors(Posterior.from_samples(single, places_at_angles(angles)))["expected"]

    wi, wo = plan_directions(single, 6, InstrumentLimits(), NOTHING, Generator().manual_seed(0))
    first = directions_to_full_rusinkiewicz(wi, wo)
    assert left(first) < min(left(angles_of(6, seed)) for seed in range(20))
    more = directions_to_full_rusinkiewicz(
        *plan_directions(single, 6, InstrumentLimits(), first, Generator().manual_seed(0))
    )
    assert left(torch.cat([first, more])) < left(torch.cat([first, first]))
