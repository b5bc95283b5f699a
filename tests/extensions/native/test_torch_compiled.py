"""Steps that torch compiles: those of torch alone."""

from __future__ import annotations

import shutil
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from metapp.extensions.native.fastest import Compiled
from metapp.learning.adjoint import TORCH, Engine, Loss
from metapp.learning.app import App
from metapp.learning.learn import after_learning
from metapp.learning.rules import rule_of
from metapp.learning.task import Params
from tests.learning.conftest import randn
from tests.learning.parabolas import unused
from tests.learning.rules.test_learned_descent import STEPS, batches_for, phi_of, small_app
from tests.learning.test_adjoint import ON_MATRICES, assert_alike, brdf_case, value_and_grads

__all__ = ["randn"]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (shutil.which("g++") or shutil.which("clang++")), reason="torch.compile needs g++"),
]


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("rule", ON_MATRICES)
def test_same_as_eager(rule: str, order: int, randn: Callable[..., Tensor]) -> None:
    phi, mean = brdf_case(rule, randn)
    assert_alike(*(value_and_grads(mean(order, engine), phi) for engine in (Compiled(), TORCH)))


def mean_after_learning(app: App, batches: list[dict[str, Tensor]], engine: Engine) -> Callable[[Params], Tensor]:
    lifted = after_learning(Loss(unused, app.loss), rule_of("meta-lgd").rule, steps=STEPS, order=2, engine=engine)
    return lambda phi: lifted.value(phi, (batches[:-1], batches[-1], None), {}).mean()


def gradients(mean: Callable[[Params], Tensor], phi: Params) -> Params:
    leaves = {key: value.detach().clone().requires_grad_() for key, value in phi.items()}
    return dict(zip(leaves, torch.autograd.grad(mean(leaves), list(leaves.values())), strict=True))


def test_same_with_networks_in_the_rule(randn: Callable[..., Tensor]) -> None:
    app = small_app()
    phi, batches = phi_of(app, randn), batches_for(app, randn, STEPS + 1)
    eager, compiled = (gradients(mean_after_learning(app, batches, engine), phi) for engine in (TORCH, Compiled()))
    for key, value in eager.items():
        torch.testing.assert_close(compiled[key], value, rtol=1e-7, atol=1e-12)
