"""Update rules against torch.optim, and what the learned ones start from."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import pytest
import torch
from torch import Generator, Tensor

from metapp.apps.brdf import APP
from metapp.learning.adjoint import UpdateRule, at_step
from metapp.learning.learn import spread
from metapp.learning.recipe import Adam, Training
from metapp.learning.rules import (
    META_EPS,
    RULES,
    _rotate,
    fixed_adam,
    half_cosine,
    outer_adam,
    principal_axes,
    second_moments,
    sgd,
)
from metapp.learning.task import Params

STEPS = 12


@pytest.fixture
def theta(rng: Generator) -> Params:
    return {key: value.double() for key, value in APP.init(rng, 2).items()}


@pytest.fixture
def grads(theta: Params, rng: Generator) -> list[Params]:
    """One gradient a step, magnitudes from 1e-3 to 1e3; some weights never get any."""
    draws = [{key: torch.randn(value.shape, generator=rng).double() for key, value in theta.items()} for _ in range(12)]
    for i, draw in enumerate(draws):
        for value in draw.values():
            value *= 10.0 ** (i % 7 - 3)
            value.flatten()[0] = 0.0
    return draws


def run(rule: UpdateRule, theta: Params, grads: list[Params]) -> list[Params]:
    """The parameters after each step."""
    state, path = rule.init(theta), []
    for i, grad in enumerate(grads):
        theta, state = rule.step(at_step(rule.alpha, i), theta, grad, state)
        path.append(theta)
    return path


def run_torch(optimiser: torch.optim.Optimizer, leaves: Params, grads: list[Params], after: Callable) -> list[Params]:
    path = []
    for grad in grads:
        for key, leaf in leaves.items():
            leaf.grad = grad[key].clone()
        optimiser.step()
        after()
        path.append({key: leaf.detach().clone() for key, leaf in leaves.items()})
    return path


def assert_same(actual: list[Params], expected: list[Params]) -> None:
    # rates and betas are float32
    for i, (one, other) in enumerate(zip(actual, expected, strict=True)):
        for key, value in other.items():
            assert torch.allclose(one[key], value, rtol=1e-5, atol=1e-7), f"step {i}, {key}"


def copies(theta: Params) -> Params:
    return {key: value.clone().requires_grad_() for key, value in theta.items()}


def test_half_cosine_values() -> None:
    rates = half_cosine(0.5, 8, final=0.2)
    assert rates.dtype == torch.float32
    cosine = [0.5 * (1 + math.cos(math.pi * i / 8)) for i in range(8)]
    torch.testing.assert_close(rates, torch.tensor([0.5 * (0.2 + 0.8 * each) for each in cosine]))
    assert rates[0] == 0.5
    torch.testing.assert_close(rates[4], torch.tensor(0.5 * 0.6))
    assert (half_cosine(0.5, 8).diff() == 0).all()
    assert (rates.diff() < 0).all()


def test_half_cosine_warm_up() -> None:
    rates = half_cosine(2.0, 104, final=0.0, warmup=4)
    torch.testing.assert_close(rates[:5], torch.tensor([0.4, 0.8, 1.2, 1.6, 2.0]))
    torch.testing.assert_close(rates[54], torch.tensor(1.0))
    assert (rates > 0).all()
    assert half_cosine(1.0, 0).shape == (1,)
    assert torch.isfinite(half_cosine(1.0, 2, warmup=10)).all()


@pytest.mark.parametrize(
    "settings", [Adam(1e-2), Adam(3e-3, 0.5, 0.9, 1e-3), Adam(1e-2, final=0.0), Adam(1e-2, 0.8, 0.99, 1e-8, 0.1)]
)
def test_fixed_adam_is_torch_adam(settings: Adam, theta: Params, grads: list[Params]) -> None:
    leaves = copies(theta)
    betas = (settings.beta1, settings.beta2)
    optimiser = torch.optim.Adam(leaves.values(), lr=settings.rate, betas=betas, eps=settings.eps)
    low = settings.rate * settings.final
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, STEPS, eta_min=low)
    assert_same(
        run(fixed_adam(settings, theta, STEPS), theta, grads), run_torch(optimiser, leaves, grads, schedule.step)
    )


def test_outer_adam_is_torch_adam_with_l2(theta: Params, grads: list[Params]) -> None:
    training = Training(STEPS, 1, {"": 1e-3, "w": 1e-2, "w3": 1e-4}, warmup=3, final=0.1, decay=0.3)
    leaves = copies(theta)
    rates = {"w1": 1e-2, "w2": 1e-2, "w3": 1e-4}
    groups = [{"params": [leaf], "lr": rates.get(key, 1e-3)} for key, leaf in leaves.items()]
    optimiser = torch.optim.Adam(groups, weight_decay=training.decay)
    schedule = torch.optim.lr_scheduler.LambdaLR(
        optimiser, lambda i: float(half_cosine(1.0, STEPS, 0.1, 3)[min(i, 11)])
    )
    assert_same(run(outer_adam(training, theta), theta, grads), run_torch(optimiser, leaves, grads, schedule.step))


def test_sgd_takes_any_sign(theta: Params, grads: list[Params]) -> None:
    rates = {f"rate.{key}": torch.randn(1, *value.shape, dtype=torch.float64) for key, value in theta.items()}
    moved = run(sgd(rates), theta, grads[:1])[0]
    for key, value in theta.items():
        torch.testing.assert_close(moved[key], value - rates[f"rate.{key}"][0] * grads[0][key])


def test_one_rate_for_each_task(theta: Params, grads: list[Params]) -> None:
    moved = run(sgd({"rate": torch.tensor([[0.0, 2.0]], dtype=torch.float64)}), theta, grads[:1])[0]
    for key, value in theta.items():
        assert torch.equal(moved[key][0], value[0])
        torch.testing.assert_close(moved[key][1], value[1] - 2 * grads[0][key][1])


def one_task(theta: Params) -> Params:
    return {key: value[0] for key, value in theta.items()}


@pytest.mark.parametrize("rule", list(RULES))
def test_learned_rules_start_well_formed(rule: str, theta: Params) -> None:
    alpha = RULES[rule].alpha(APP, one_task(theta), 5, Adam(5e-3, beta2=0.99))
    for key, value in alpha.items():
        assert value.dtype == torch.float64 or rule == "meta-sgd", key
        # one entry for all steps, or one a step
        paced = f"pace.{key.removeprefix('rate.')}" in alpha
        tied = rule == "meta-sgd" or paced or key == "eps" or key.startswith(("out.", "in."))
        assert value.shape[0] == (1 if tied else 5), key
        value += 0  # each has memory of its own, which training may write to
    built = RULES[rule].rule(alpha)
    assert {key for key in built.alpha if key.startswith("loss.")} == (
        set() if rule == "meta-sgd" else {f"loss.{key}" for key in APP.loss_parameters(5)}
    )


@pytest.mark.parametrize("settings", [Adam(5e-3, beta2=0.99), Adam(2e-2, 0.6, 0.95, final=0.1), Adam(1e-3, final=0.0)])
@pytest.mark.parametrize("rule", [name for name in RULES if name != "meta-sgd"])
def test_learned_adam_starts_as_adam(rule: str, settings: Adam, theta: Params, grads: list[Params]) -> None:
    start, single = one_task(theta), [one_task(grad) for grad in grads]
    own = dataclasses.replace(settings, eps=1e-3)
    learned = RULES[rule].rule(RULES[rule].alpha(APP, start, STEPS, own))
    plain = fixed_adam(own if "eps" in learned.alpha else dataclasses.replace(own, eps=META_EPS), start, STEPS)
    until = -1 if "mean" in learned.alpha else None  # the last answer is a mean then
    assert_same(run(learned, start, single)[:until], run(plain, start, single)[:until])


def test_tied_rates_are_adam_s_where_its_rates_are_alike(theta: Params, grads: list[Params]) -> None:
    """With paces of 0 and the same rates at every step; a pace multiplies the rates of one tensor at one step."""
    start, single, rng = one_task(theta), [one_task(grad) for grad in grads], Generator().manual_seed(0)
    tied = RULES["meta-adam-tied"].alpha(APP, start, STEPS, Adam(5e-3, beta2=0.99))
    free = RULES["meta-adam"].alpha(APP, start, STEPS, Adam(5e-3, beta2=0.99))
    for key in start:
        tied[f"rate.{key}"] = tied[f"rate.{key}"] + torch.randn(start[key].shape, generator=rng).double()
        free[f"rate.{key}"] = tied[f"rate.{key}"].repeat(STEPS, *[1] * start[key].ndim)
    assert set(tied) - set(free) == {f"pace.{key}" for key in start}
    path = run(RULES["meta-adam-tied"].rule(tied), start, single)
    assert_same(path, run(RULES["meta-adam"].rule(free), start, single))

    tied["pace.w2"] = tied["pace.w2"].clone()
    tied["pace.w2"][3] = math.log(3)
    free["rate.w2"][3] += math.log(3)
    paced = run(RULES["meta-adam-tied"].rule(tied), start, single)
    assert_same(paced, run(RULES["meta-adam"].rule(free), start, single))
    torch.testing.assert_close(paced[3]["w2"] - paced[2]["w2"], 3 * (path[3]["w2"] - path[2]["w2"]))


def test_tied_rates_of_each_task_stand_for_themselves(theta: Params, grads: list[Params]) -> None:
    alpha = RULES["meta-adam-tied"].alpha(APP, one_task(theta), STEPS, Adam(5e-3, beta2=0.99))
    for key in theta:
        alpha[f"pace.{key}"] = torch.linspace(-1, 1, STEPS).double()
    both = run(RULES["meta-adam-tied"].rule(spread(alpha, 2, 1)), theta, grads)[-1]
    for task in (0, 1):
        start, own = ({key: value[task] for key, value in tree.items()} for tree in (theta, grads[0]))
        single = [{key: grad[key][task] for key in own} for grad in grads]
        alone = run(RULES["meta-adam-tied"].rule(alpha), start, single)[-1]
        for key, value in alone.items():
            torch.testing.assert_close(both[key][task], value)


@pytest.mark.parametrize("steps", [1, 15])
def test_tied_rates_are_few(steps: int, theta: Params) -> None:
    start = one_task(theta)
    weights = sum(value.numel() for value in start.values())
    learned = sum(value.numel() for value in APP.loss_parameters(steps).values())

    def size(rule: str) -> int:
        return sum(value.numel() for value in RULES[rule].alpha(APP, start, steps, Adam(5e-3, beta2=0.99)).values())

    assert size("meta-sgd") == weights
    assert size("meta-adam-tied") == weights + steps * (len(start) + 2) + learned
    assert size("meta-adam") == steps * (weights + 2) + learned


def test_curvature_multiplies_from_both_sides(theta: Params, grads: list[Params]) -> None:
    start, rng = one_task(theta), Generator().manual_seed(0)
    alpha = RULES["meta-curvature"].alpha(APP, start, STEPS, Adam(5e-3, beta2=0.99))
    left, right = (torch.randn(21, 21, generator=rng).double() for _ in "lr")
    alpha |= {"left.w2": left[None], "right.w2": right[None]}
    plain = RULES["meta-adam"].alpha(APP, start, STEPS, Adam(5e-3, beta2=0.99))
    first = one_task(grads[0])
    bent = run(RULES["meta-curvature"].rule(alpha), start, [first])[0]
    straight = run(RULES["meta-adam"].rule(plain), start, [first])[0]
    torch.testing.assert_close(bent["w2"] - start["w2"], left @ (straight["w2"] - start["w2"]) @ right)
    for key in set(start) - {"w2"}:
        torch.testing.assert_close(bent[key], straight[key])


def test_rules_do_not_mix_tasks(theta: Params, grads: list[Params]) -> None:
    """Tensor by tensor, another task beside it changes nothing."""
    for rule in (fixed_adam(Adam(1e-2), theta, STEPS), sgd({"rate": torch.full((1,), 0.1, dtype=torch.float64)})):
        both = run(rule, theta, grads)[-1]
        for task in (0, 1):
            own = {key: value[task : task + 1] for key, value in theta.items()}
            alone = run(rule, own, [{key: value[task : task + 1] for key, value in grad.items()} for grad in grads])[-1]
            for key, value in alone.items():
                assert torch.equal(both[key][task : task + 1], value)


def test_adam_moves_dead_weights_nowhere(theta: Params) -> None:
    zero: list[dict[str, Tensor]] = [{key: torch.zeros_like(value) for key, value in theta.items()}] * 3
    for key, value in run(fixed_adam(dataclasses.replace(Adam(1e-2), beta1=0.5), theta, 3), theta, zero)[-1].items():
        assert torch.equal(value, theta[key])


@pytest.mark.parametrize("steps", [1, 5, 15])
def test_the_mean_of_the_last_parameters_is_the_answer(steps: int, theta: Params, rng: Generator) -> None:
    start = one_task(theta)
    grads = [{key: torch.randn(v.shape, generator=rng).to(v) for key, v in start.items()} for _ in range(steps)]
    tied, mean = (
        RULES[rule].alpha(APP, start, steps, Adam(5e-3, eps=META_EPS)) for rule in ("meta-adam-tied", "meta-mean")
    )
    path = run(RULES["meta-adam-tied"].rule(tied), start, grads)
    averaged = run(RULES["meta-mean"].rule(mean), start, grads)
    assert_same(averaged[:-1], path[:-1])
    last = path[-max(round(0.4 * steps), 1) :]
    for key in start:
        torch.testing.assert_close(averaged[-1][key], torch.stack([each[key] for each in last]).mean(0))


def test_bases_are_turned_to_the_axes_of_gradients(rng: Generator) -> None:
    """Gradients that are alike but for a rotation of their rows and columns become diagonal."""
    rows, columns = (torch.linalg.qr(torch.randn(n, n, generator=rng, dtype=torch.float64)).Q for n in (4, 3))
    cores = torch.zeros(50, 4, 3).double()
    for i in range(3):
        cores[:, i, i] = torch.randn(50, generator=rng).double() * (i + 1)
    alpha = {"out.w": torch.eye(4).double()[None], "in.w": torch.eye(3).double()[None], "pace.w": torch.zeros(1)}
    gradients = {"w": rows @ cores @ columns.mT, "b": torch.ones(50, 4)}
    turned = principal_axes(alpha, second_moments(alpha, gradients))
    assert turned.keys() == alpha.keys()
    for name in ("out.w", "in.w"):
        basis = turned[name][0]
        torch.testing.assert_close(basis @ basis.mT, torch.eye(len(basis)).double())
    own = spread(turned, 50, 1)
    inside = _rotate(at_step(own, 0), "w", gradients["w"])
    assert ((inside.abs() > 1e-9).sum((1, 2)) <= 3).all()  # one entry a row and column
    torch.testing.assert_close(_rotate(at_step(own, 0), "w", inside, back=True), gradients["w"])


def test_second_moments_weigh_tasks_alike(rng: Generator) -> None:
    alpha = {"out.w": torch.eye(2)[None], "in.w": torch.eye(3)[None]}
    gradient = torch.randn(5, 2, 3, 3, 3, generator=rng)
    scaled = gradient * torch.tensor([1e-3, 1.0, 1e3, 5.0, 1e-9]).reshape(-1, 1, 1, 1, 1)
    assert_same([second_moments(alpha, {"w": gradient})], [second_moments(alpha, {"w": scaled})])
    assert float(second_moments(alpha, {"w": gradient})["out.w"].trace()) == pytest.approx(5)
