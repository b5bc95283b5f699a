"""Parts and named rules in closed form, before they have learned, and with nothing learned as torch.optim."""

import dataclasses
import math
from collections.abc import Callable

import pytest
import torch
from torch import Generator

from metapp.apps.brdf.app import Brdf
from metapp.learned_rules import rule_of
from metapp.learning.adjoint import UpdateRule, at_step
from metapp.learning.learn import expand_tasks
from metapp.learning.recipe import Adam, MetaTraining
from metapp.learning.rules import META_EPS, LearnedRule, Part, fixed_adam, half_cosine, outer_adam, sgd
from metapp.learning.rules.parts import (
    AdamDirections,
    Average,
    Basis,
    Curvature,
    LossParameters,
    Rates,
    tail_averaging_weights,
)
from metapp.learning.task import Params
from tests.paradigms.small import applicable_rules

APP = Brdf()
STEPS = 12


def run(rule: UpdateRule, theta: Params, grads: list[Params]) -> list[Params]:
    """The parameters after each step."""
    state, path = rule.init(theta), []
    for i, grad in enumerate(grads):
        theta, state = rule.step(at_step(rule.alpha, i), theta, grad, state)
        path.append(theta)
    return path


def assert_same(actual: list[Params], expected: list[Params]) -> None:
    """Assert that results agree to the rounding of rates and betas, which are float32."""
    torch.testing.assert_close(actual, expected, rtol=1e-5, atol=1e-7)


def assert_equal(actual: list[Params], expected: list[Params]) -> None:
    torch.testing.assert_close(actual, expected, rtol=0, atol=0)


def one_task(theta: Params) -> Params:
    """Parameters, or gradients, of the first task, without task axis."""
    return {key: value[0] for key, value in theta.items()}


# Parameters and gradients


@pytest.fixture
def theta(rng: Generator) -> Params:
    return {key: value.double() for key, value in APP.init(rng, 2).items()}


@pytest.fixture
def start(theta: Params) -> Params:
    """The parameters of one task, without task axis."""
    return one_task(theta)


@pytest.fixture
def single(grads: list[Params]) -> list[Params]:
    """Its gradients."""
    return [one_task(grad) for grad in grads]


@pytest.fixture
def grads(theta: Params, rng: Generator) -> list[Params]:
    """One gradient a step, magnitudes from 1e-3 to 1e3; some weights never get any."""
    draws = [
        {key: torch.randn(value.shape, generator=rng).double() for key, value in theta.items()} for _ in range(STEPS)
    ]
    for i, draw in enumerate(draws):
        for value in draw.values():
            value *= 10.0 ** (i % 7 - 3)
            value.flatten()[0] = 0.0
    return draws


# Parts and named rules


ON_MATRICES = applicable_rules(APP)

FIRST = Adam(5e-3, 0.8, 0.99, eps=1e-3, final_rate_share=0.1)
BASIS = Basis()
SIGNED, PACED = (Rates("signed"),), (Rates("paced"),)
ADAM, PACED_ADAM = (Rates("stepwise"), AdamDirections()), (*PACED, AdamDirections())


def path_of(
    parts: tuple[Part, ...], start: Params, single: list[Params], changes: Params | None = None
) -> list[Params]:
    """The parameters of one task after each step by a rule of these parts, as it is at first but for some changes."""
    rule = LearnedRule("test", parts)
    return run(rule.update_rule(rule.initial_alpha(APP, start, len(single), FIRST) | (changes or {})), start, single)


# What changes nothing before it has learned


@pytest.mark.parametrize("base", [ADAM, (*PACED, AdamDirections(learns_eps=True)), SIGNED])
def test_at_first_a_part_changes_nothing(base: tuple[Part, ...], start: Params, single: list[Params]) -> None:
    """The average of one step is its result."""
    for part in (LossParameters(), Curvature(), BASIS):
        assert_equal(path_of((*base, part), start, single), path_of(base, start, single))
    assert_equal(path_of((*base, Average()), start, single[:1]), path_of(base, start, single[:1]))


# Closed forms


def log_rates(start: Params, rate: float) -> Params:
    return {f"rate.{key}": torch.full((1, *value.shape), math.log(rate)).double() for key, value in start.items()}


def no_paces(start: Params, steps: int) -> Params:
    return {f"pace.{key}": torch.zeros(steps).double() for key in start}


def test_without_moments_rates_are_of_the_gradient(start: Params, single: list[Params]) -> None:
    after = path_of(PACED, start, single[:1], log_rates(start, 0.3))
    torch.testing.assert_close(after, [{key: value - 0.3 * single[0][key] for key, value in start.items()}])


def test_betas_may_differ_from_step_to_step(start: Params, single: list[Params]) -> None:
    """Two steps by hand: a moment is a mean with weights that add up to 1 once divided by 1 - beta(1) beta(2)."""
    (b1, b2), (c1, c2), rate = (0.9, 0.4), (0.99, 0.8), 0.1
    changes = {
        "beta1": torch.logit(torch.tensor([b1, b2], dtype=torch.float64)),
        "beta2": torch.logit(torch.tensor([c1, c2], dtype=torch.float64)),
    }
    first, second = path_of(PACED_ADAM, start, single[1:3], changes | log_rates(start, rate) | no_paces(start, 2))
    for key in start:
        g, h = single[1][key], single[2][key]
        mean = (b2 * (1 - b1) * g + (1 - b2) * h) / (1 - b1 * b2)
        square = (c2 * (1 - c1) * g * g + (1 - c2) * h * h) / (1 - c1 * c2)
        torch.testing.assert_close(first[key] - second[key], rate * mean / ((square + 1e-24).sqrt() + META_EPS))


def test_eps_divides_small_gradients(start: Params, single: list[Params]) -> None:
    """Adam's first direction is g / (|g| + eps)."""
    (after,) = path_of(
        (Rates(), AdamDirections(learns_eps=True)),
        start,
        single[:1],
        {"eps": torch.tensor([math.log(0.02)], dtype=torch.float64)},
    )
    for key, value in start.items():
        grad = single[0][key]
        torch.testing.assert_close(value - after[key], FIRST.rate * grad / (grad.abs() + 0.02), rtol=1e-5, atol=1e-12)


def test_curvature_is_of_axes_that_have_more_than_one_entry(start: Params) -> None:
    alpha = Curvature().initial(APP, start, 3, FIRST)
    assert {key: tuple(value.shape) for key, value in alpha.items() if key.endswith((".w1", ".b1"))} == {
        "left.w1": (3, 21, 21),
        "right.w1": (3, 6, 6),
        "left.b1": (3, 21, 21),
    }


def test_plain_descent_is_the_same_in_all_bases(start: Params, single: list[Params], rng: Generator) -> None:
    """Where all weights have one rate, a gradient that is rotated and rotated back is unchanged."""
    bases = {
        key: torch.linalg.qr(torch.randn(value.shape, generator=rng).double()).Q
        for key, value in BASIS.initial(APP, start, 1, FIRST).items()
    }
    torch.testing.assert_close(path_of((*SIGNED, BASIS), start, single, bases), path_of(SIGNED, start, single))
    turned = path_of((*ADAM, BASIS), start, single, bases)[0]
    assert not torch.allclose(turned["w2"], path_of(ADAM, start, single)[0]["w2"])  # as Adam's is not


def test_averaging_is_over_the_last_of_the_steps_of_a_fit() -> None:
    alpha = Average().for_steps(tail_averaging_weights(20) | {"beta1": torch.ones(20)}, 5)
    torch.testing.assert_close(alpha, tail_averaging_weights(5) | {"beta1": torch.ones(20)}, rtol=0, atol=0)


# Taken from gradients


def test_bases_are_turned_to_the_axes_of_gradients(rng: Generator) -> None:
    """Gradients that are alike but for a rotation of their rows and columns become diagonal."""
    rows, columns = (torch.linalg.qr(torch.randn(n, n, generator=rng, dtype=torch.float64)).Q for n in (4, 3))
    cores = torch.zeros(50, 4, 3).double()
    for i in range(3):
        cores[:, i, i] = torch.randn(50, generator=rng).double() * (i + 1)
    alpha = {"out.w": torch.eye(4).double()[None], "in.w": torch.eye(3).double()[None], "pace.w": torch.zeros(1)}
    gradients = {"w": rows @ cores @ columns.mT, "b": torch.ones(50, 4)}
    turned = BASIS.from_statistics(alpha, BASIS.gradient_statistics(alpha, gradients))
    assert turned.keys() == alpha.keys()
    for name in ("out.w", "in.w"):
        basis = turned[name][0]
        torch.testing.assert_close(basis @ basis.mT, torch.eye(len(basis)).double())
    task_theta = expand_tasks(turned, 50, 1)
    inside = BASIS.gradients(at_step(task_theta, 0), gradients)["w"]
    assert ((inside.abs() > 1e-9).sum((1, 2)) <= 3).all()  # one entry a row and column
    torch.testing.assert_close(BASIS.updates(at_step(task_theta, 0), {"w": inside})["w"], gradients["w"])


def test_second_moments_weigh_tasks_alike(rng: Generator) -> None:
    alpha = {"out.w": torch.eye(2)[None], "in.w": torch.eye(3)[None]}
    gradient = torch.randn(5, 2, 3, 3, 3, generator=rng)
    scaled = gradient * torch.tensor([1e-3, 1.0, 1e3, 5.0, 1e-9]).reshape(-1, 1, 1, 1, 1)
    assert_same([BASIS.gradient_statistics(alpha, {"w": gradient})], [BASIS.gradient_statistics(alpha, {"w": scaled})])
    assert float(BASIS.gradient_statistics(alpha, {"w": gradient})["out.w"].trace()) == pytest.approx(5)


# Named rules


@pytest.mark.parametrize(
    "settings", [Adam(5e-3, beta2=0.99), Adam(2e-2, 0.6, 0.95, final_rate_share=0.1), Adam(1e-3, final_rate_share=0.0)]
)
@pytest.mark.parametrize("rule", [name for name in ON_MATRICES if rule_of(name).parts[0] != Rates("signed")])
def test_learned_adam_starts_as_adam(rule: str, settings: Adam, start: Params, single: list[Params]) -> None:
    changed_settings = dataclasses.replace(settings, eps=1e-3)
    learned = rule_of(rule).update_rule(rule_of(rule).initial_alpha(APP, start, STEPS, changed_settings))
    plain = fixed_adam(
        changed_settings if "eps" in learned.alpha else dataclasses.replace(changed_settings, eps=META_EPS),
        start,
        STEPS,
    )
    until = -1 if "mean" in learned.alpha else None  # the last answer is a mean then
    assert_same(run(learned, start, single)[:until], run(plain, start, single)[:until])


def test_paced_rates_are_stepwise_rates_where_these_are_alike(
    start: Params, single: list[Params], rng: Generator
) -> None:
    """They agree where paces are 0 and all steps have the same rates.

    A pace multiplies the rates of one tensor at one step.
    """
    paced_rates = {
        key: value + torch.randn(value.shape, generator=rng).double() for key, value in log_rates(start, 5e-3).items()
    }
    stepwise = {key: value.repeat(STEPS, *[1] * (value.ndim - 1)) for key, value in paced_rates.items()}
    paced_rates |= no_paces(start, STEPS)
    path = path_of(PACED_ADAM, start, single, paced_rates)
    assert_same(path, path_of(ADAM, start, single, stepwise))
    paced_rates["pace.w2"][3] = math.log(3)
    stepwise["rate.w2"][3] += math.log(3)
    faster = path_of(PACED_ADAM, start, single, paced_rates)
    assert_same(faster, path_of(ADAM, start, single, stepwise))
    torch.testing.assert_close(faster[3]["w2"] - faster[2]["w2"], 3 * (path[3]["w2"] - path[2]["w2"]))


def test_curvature_multiplies_from_both_sides(start: Params, single: list[Params], rng: Generator) -> None:
    left, right = (torch.randn(1, 21, 21, generator=rng).double() for _ in "lr")
    (bent,) = path_of((*ADAM, Curvature()), start, single[:1], {"left.w2": left, "right.w2": right})
    (straight,) = path_of(ADAM, start, single[:1])
    torch.testing.assert_close(bent["w2"] - start["w2"], left[0] @ (straight["w2"] - start["w2"]) @ right[0])
    torch.testing.assert_close(bent | {"w2": straight["w2"]}, straight)


@pytest.mark.parametrize("steps", [1, 4, 5, 15])
def test_tail_averaging_gives_the_mean_of_the_last_parameters(steps: int, start: Params, rng: Generator) -> None:
    grads = [{key: torch.randn(v.shape, generator=rng).to(v) for key, v in start.items()} for _ in range(steps)]
    path, averaged = (path_of(parts, start, grads) for parts in (PACED_ADAM, (*PACED_ADAM, Average())))
    assert_same(averaged[:-1], path[:-1])
    last = path[-max(round(0.4 * steps), 1) :]
    torch.testing.assert_close(
        averaged[-1], {key: torch.stack([iterate[key] for iterate in last]).mean(0) for key in start}
    )


# Rules with nothing learned, against torch.optim


def run_torch(optimiser: torch.optim.Optimizer, leaves: Params, grads: list[Params], after: Callable) -> list[Params]:
    path = []
    for grad in grads:
        for key, leaf in leaves.items():
            leaf.grad = grad[key].clone()
        optimiser.step()
        after()
        path.append({key: leaf.detach().clone() for key, leaf in leaves.items()})
    return path


def copies(theta: Params) -> Params:
    return {key: value.clone().requires_grad_() for key, value in theta.items()}


def test_rates_warm_up_and_fall_by_half_a_cosine() -> None:
    rates = half_cosine(2.0, 104, final_rate_share=0.0, warmup_steps=4)
    torch.testing.assert_close(rates[:5], torch.tensor([0.4, 0.8, 1.2, 1.6, 2.0]))
    torch.testing.assert_close(rates[54], torch.tensor(1.0))
    assert (rates > 0).all()
    assert half_cosine(1.0, 0).shape == (1,)
    assert torch.isfinite(half_cosine(1.0, 2, warmup_steps=10)).all()


def test_rates_have_the_default_precision() -> None:
    """A rate of float32 among numbers of float64 is off by 5e-8, by which long trainings end elsewhere."""
    torch.set_default_dtype(torch.float64)
    try:
        assert torch.equal(half_cosine(0.001, 500), torch.full((500,), 0.001))
    finally:
        torch.set_default_dtype(torch.float32)


@pytest.mark.parametrize(
    "settings",
    [Adam(1e-2), Adam(3e-3, 0.5, 0.9, 1e-3), Adam(1e-2, final_rate_share=0.0), Adam(1e-2, 0.8, 0.99, 1e-8, 0.1)],
)
def test_fixed_adam_agrees_with_torch_adam(settings: Adam, theta: Params, grads: list[Params]) -> None:
    leaves = copies(theta)
    betas = (settings.beta1, settings.beta2)
    optimiser = torch.optim.Adam(leaves.values(), lr=settings.rate, betas=betas, eps=settings.eps)
    low = settings.rate * settings.final_rate_share
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, STEPS, eta_min=low)
    assert_same(
        run(fixed_adam(settings, theta, STEPS), theta, grads), run_torch(optimiser, leaves, grads, schedule.step)
    )


def test_outer_adam_agrees_with_torch_adam_with_l2(theta: Params, grads: list[Params]) -> None:
    training = MetaTraining(
        STEPS, 1, {"": 1e-3, "w": 1e-2, "w3": 1e-4}, warmup_steps=3, final_rate_share=0.1, weight_decay=0.3
    )
    leaves = copies(theta)
    rates = {"w1": 1e-2, "w2": 1e-2, "w3": 1e-4}
    groups = [{"params": [leaf], "lr": rates.get(key, 1e-3)} for key, leaf in leaves.items()]
    optimiser = torch.optim.Adam(groups, weight_decay=training.weight_decay)
    schedule = torch.optim.lr_scheduler.LambdaLR(
        optimiser, lambda i: float(half_cosine(1.0, STEPS, 0.1, 3)[min(i, 11)])
    )
    assert_same(run(outer_adam(training, theta), theta, grads), run_torch(optimiser, leaves, grads, schedule.step))


def test_sgd_takes_rates_of_any_sign_and_of_each_task(theta: Params, grads: list[Params]) -> None:
    rates = {f"rate.{key}": torch.randn(1, *value.shape, dtype=torch.float64) for key, value in theta.items()}
    moved = run(sgd(rates), theta, grads[:1])[0]
    by_task = run(sgd({"rate": torch.tensor([[0.0, 2.0]], dtype=torch.float64)}), theta, grads[:1])[0]
    for key, value in theta.items():
        torch.testing.assert_close(moved[key], value - rates[f"rate.{key}"][0] * grads[0][key])
        assert torch.equal(by_task[key][0], value[0])
        torch.testing.assert_close(by_task[key][1], value[1] - 2 * grads[0][key][1])
