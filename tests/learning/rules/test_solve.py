"""Least squares as a rule: closed forms, the derivative through it, what it refuses."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Generator, Tensor

from metapp.learning.adjoint import DrawnBatch, learn_differentiably
from metapp.learning.learn import expand_tasks, learn
from metapp.learning.recipe import Adam
from metapp.learning.rules import LearnedRule
from metapp.learning.rules.solve import MAX_PENALTY, MIN_PENALTY, ROUNDING_FACTOR, NormalEquations, Solve
from metapp.learning.task import Batch, LeastSquares, Params
from tests.learning.parabolas import refuse_to_draw
from tests.paradigms.small import FEATURE_NETWORK, small_app

TASKS, FEATURES, OUTPUTS, SAMPLES, STEPS = 3, 5, 2, 11, 4
SOLVE = LearnedRule("solve", (Solve(),))


def linear(theta: Params, batch: Batch, loss_parameters: Params) -> LeastSquares:
    features = theta["scale"][:, :, None] * batch["x"]
    residual = batch["y"] - theta["W"] @ features
    return LeastSquares("W", features, residual, batch["weights"], residual.abs().mean((1, 2)))


def value(theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
    """Half the weighted sum of squares, whose minimum is the solution."""
    of = linear(theta, batch, loss_parameters)
    return 0.5 * (of.weights[:, None] * of.residual.square()).mean(2).sum(1)


LOSS = NormalEquations(refuse_to_draw, value, linear=linear)


@pytest.fixture
def theta(randn: Callable[..., Tensor]) -> Params:
    return {"W": randn(TASKS, OUTPUTS, FEATURES), "scale": randn(TASKS, FEATURES).exp()}


@pytest.fixture
def batches(randn: Callable[..., Tensor]) -> list[Batch]:
    return [
        {
            "x": randn(TASKS, FEATURES, SAMPLES),
            "y": randn(TASKS, OUTPUTS, SAMPLES),
            "weights": randn(TASKS, SAMPLES).exp(),
        }
        for _ in range(STEPS)
    ]


def alpha_of(theta: Params, keep: float = 40.0, penalties: tuple[float, float] = (-3.0, 1.0)) -> Params:
    """Return penalties that differ from feature to feature, of all outputs; a `keep` of 40 keeps all samples."""
    penalty = torch.linspace(*penalties, FEATURES, dtype=torch.float64).expand(1, OUTPUTS, -1)
    alpha = {"penalty.W": penalty, "keep.W": torch.full((STEPS,), keep, dtype=torch.float64)}
    return expand_tasks(alpha, len(theta["W"]), 1)


def ridge(theta: Params, batches: list[Batch], penalty: Tensor) -> Tensor:
    """W of least squares on all samples with penalties around the first W, by augmented rows and numpy's solver."""
    solved = []
    for t in range(TASKS):
        x, y, w = (torch.cat([batch[key][t] for batch in batches], -1) for key in ("x", "y", "weights"))
        x, root = theta["scale"][t][:, None] * x, (w / SAMPLES).sqrt()
        rows = torch.cat([(x * root).T, torch.diag(penalty.exp().sqrt())])
        expected = torch.cat([((y - theta["W"][t] @ x) * root).T, torch.zeros(FEATURES, OUTPUTS).double()])
        solved.append(theta["W"][t] + torch.linalg.lstsq(rows, expected).solution.T)
    return torch.stack(solved)


def test_steps_add_up_to_ridge_regression_on_all_samples(theta: Params, batches: list[Batch]) -> None:
    """Plain fits take the same steps."""
    alpha = alpha_of(theta)
    final = learn_differentiably(theta, SOLVE.update_rule(alpha), batches, LOSS, order=2)
    torch.testing.assert_close(final["W"], ridge(theta, batches, alpha["penalty.W"][0, 0, 0]))
    assert torch.equal(final["scale"], theta["scale"])
    supply = iter(batches)
    loss = replace(LOSS, draw=lambda data, rng, done: DrawnBatch((), next(supply)))
    plain = learn(theta, SOLVE.update_rule(alpha), None, loss, steps=STEPS, rng=Generator())
    assert torch.equal(plain["W"], final["W"])


def test_a_prior_adds_to_the_penalties_of_each_output(theta: Params, batches: list[Batch]) -> None:
    alpha = alpha_of(theta)
    prior = torch.linspace(-2, 2, OUTPUTS * FEATURES, dtype=torch.float64).exp().reshape(1, OUTPUTS, FEATURES)

    def informed(theta: Params, batch: Batch, loss_parameters: Params) -> LeastSquares:
        return linear(theta, batch, loss_parameters)._replace(prior=prior.expand(TASKS, -1, -1))

    final = learn_differentiably(theta, SOLVE.update_rule(alpha), batches, replace(LOSS, linear=informed), order=2)
    for output in range(OUTPUTS):
        total = (alpha["penalty.W"][0, 0, output].exp() + prior[0, output]).log()
        expected = ridge(theta, batches, total)
        torch.testing.assert_close(final["W"][:, output], expected[:, output])


def test_penalties_hold_along_the_axes_of_outputs(theta: Params, batches: list[Batch]) -> None:
    """A rotation of the outputs, under which each axis is a ridge regression by its own penalties."""
    alpha = alpha_of(theta)
    alpha["penalty.W"] = alpha["penalty.W"] + torch.arange(OUTPUTS).double()[:, None]
    angle = torch.tensor(0.7, dtype=torch.float64)
    axes = torch.stack([torch.stack([angle.cos(), -angle.sin()]), torch.stack([angle.sin(), angle.cos()])])

    def rotated(theta: Params, batch: Batch, loss_parameters: Params) -> LeastSquares:
        return linear(theta, batch, loss_parameters)._replace(axes=axes)

    final = learn_differentiably(theta, SOLVE.update_rule(alpha), batches, replace(LOSS, linear=rotated), order=2)
    turned = [batch | {"y": axes.T @ batch["y"]} for batch in batches]
    for output in range(OUTPUTS):
        expected = ridge(theta | {"W": axes.T @ theta["W"]}, turned, alpha["penalty.W"][0, 0, output])
        torch.testing.assert_close((axes.T @ final["W"])[:, output], expected[:, output])


def test_a_step_that_keeps_nothing_solves_for_its_own_samples(theta: Params, batches: list[Batch]) -> None:
    alpha = alpha_of(theta, keep=-40.0)
    rule = SOLVE.update_rule(alpha)
    before = learn_differentiably(theta, rule, batches[:-1], LOSS, order=2)
    final = learn_differentiably(theta, rule, batches, LOSS, order=2)
    torch.testing.assert_close(final["W"], ridge(before, batches[-1:], alpha["penalty.W"][0, 0, 0]))


def test_penalties_are_bounded(theta: Params, batches: list[Batch]) -> None:
    """Training cannot take them to where the solve is ill-conditioned."""
    for far, bound in ((-99.0, MIN_PENALTY), (99.0, MAX_PENALTY)):
        alphas = (alpha_of(theta, penalties=(log_penalty, log_penalty)) for log_penalty in (far, math.log(bound)))
        ends = [learn_differentiably(theta, SOLVE.update_rule(alpha), batches, LOSS, order=2)["W"] for alpha in alphas]
        torch.testing.assert_close(*ends)


def test_penalties_are_at_least_the_rounding_of_gram_matrices() -> None:
    """Orthogonal features, one of them 1e7 times the others: the least penalty is lost in its square's rounding."""
    size = torch.tensor([1e7, 1.0, 2.0, 0.5, 1.0], dtype=torch.float64)
    batch = {"x": torch.diag(size)[None], "y": torch.ones(1, OUTPUTS, FEATURES).double()}
    batch["weights"] = torch.ones(1, FEATURES).double()
    theta = {"W": torch.zeros(1, OUTPUTS, FEATURES).double(), "scale": torch.ones(1, FEATURES).double()}
    rule = SOLVE.update_rule(alpha_of(theta, penalties=(-99.0, -99.0)))
    final = learn_differentiably(theta, rule, [batch], LOSS, order=2)
    gram, moment = size.square() / FEATURES, size / FEATURES
    penalty = MIN_PENALTY + ROUNDING_FACTOR * torch.finfo(torch.float64).eps * gram.sum()
    assert penalty > 100 * MIN_PENALTY
    torch.testing.assert_close(final["W"], (moment / (gram + penalty)).expand(1, OUTPUTS, -1), rtol=1e-9, atol=0)


def test_before_training_all_features_have_one_penalty(theta: Params) -> None:
    one = {"last": theta["W"][0]}
    alpha = Solve().initial(small_app(FEATURE_NETWORK), one, STEPS, Adam(1e-3))
    assert {key: tuple(tensor.shape) for key, tensor in alpha.items()} == {
        "penalty.last": (1, OUTPUTS, FEATURES),
        "keep.last": (STEPS,),
    }
    assert len(alpha["penalty.last"].unique()) == 1
