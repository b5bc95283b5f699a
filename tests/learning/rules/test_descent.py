"""Rules with nothing learned, against torch.optim."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from metapp.learning.recipe import Adam, MetaTraining
from metapp.learning.rules import fixed_adam, half_cosine, outer_adam, sgd
from metapp.learning.task import Params
from tests.learning.rules.steps import STEPS, assert_same, run


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
    training = MetaTraining(STEPS, 1, {"": 1e-3, "w": 1e-2, "w3": 1e-4}, warmup=3, final=0.1, decay=0.3)
    leaves = copies(theta)
    rates = {"w1": 1e-2, "w2": 1e-2, "w3": 1e-4}
    groups = [{"params": [leaf], "lr": rates.get(key, 1e-3)} for key, leaf in leaves.items()]
    optimiser = torch.optim.Adam(groups, weight_decay=training.decay)
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
