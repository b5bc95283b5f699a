"""Outer steps of Meta-SGD in C: the gradient and the phi of outer steps in torch, to rounding."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import pytest
import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.nbrdf_network import Nbrdf
from metapp.apps.brdf.recipes import RECIPES
from metapp.extensions.native import meta_sgd
from metapp.extensions.native.compiler import find_compiler
from metapp.learning.adjoint import Loss, Steps, UpdateRule, torch_steps
from metapp.learning.app import App
from metapp.learning.learn import DescentState, MetaParameters, descend, final_item
from metapp.learning.recipe import MetaTraining
from metapp.learning.rules import outer_adam
from metapp.learning.task import Params, Tasks
from metapp.paradigms.training import train_phi
from metapp.paradigms.trainings import Training, general_training, rule_training

EPS = torch.finfo(torch.float32).eps
# Adam moves each weight by up to the rate, whatever the gradient's size, so that a step of one loop rounds to another
# number than the other's by an eps or two of the weight; most of 100 such errors cancel. Found: 2 eps.
TOLERANCE = 20 * EPS
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="needs a C compiler: apt-get install gcc libc6-dev")
TRAINING = replace(
    RECIPES["paper"].training("meta-sgd"), steps=100, rates={"": 1e-3}, validate_every=30, final_rate_share=0.1
)


@dataclass(frozen=True)
class OwnLoss(Brdf):
    """An application with a loss of its own, which C does not know."""

    @override
    def loss(self, theta: Params, batch: Params, loss_parameters: Params) -> Tensor:
        return 2 * super().loss(theta, batch, loss_parameters)


@pytest.fixture
def tasks() -> Tasks:
    """Some materials, of which one is no row of the training tasks; all share their angles, as data sets do."""
    rng = Generator().manual_seed(0)
    vectors = torch.nn.functional.normalize(torch.randn(2, 300, 3, generator=rng), dim=2)
    where = torch.cat([*vectors, torch.rand(300, 1, generator=rng)], 1).expand(6, -1, -1)
    names = tuple("abcdef")
    return Tasks(names, {"where": where, "target": torch.rand(6, 300, 3, generator=rng)}, torch.tensor([5, 1, 2, 3, 0]))


def training_of(outer_loop: MetaTraining, app: App | None = None, rule: str = "") -> Training:
    """Return the training of Meta-SGD by the paper's recipe with another outer loop, of 4 inner steps of 64 samples."""
    recipe = replace(RECIPES["paper"], steps=4, samples=64, meta={"meta-sgd": outer_loop})
    return rule_training(app or recipe.app, recipe, rule)


def first_phi(training: Training, tasks: Tasks) -> Params:
    return training.first_phi(None, tasks, Generator().manual_seed(1)).flatten()


def outer_loss_of(training: Training, phi: Params) -> Loss:
    assert training.outer_loss is not None
    return training.outer_loss(MetaParameters.unflatten(phi))


def descend_by(make_steps: Callable, training: Training, tasks: Tasks) -> list[DescentState]:
    """Descend the outer loss by steps of torch or of C."""
    phi, rng, outer_loop = first_phi(training, tasks), Generator().manual_seed(2), training.outer_loop
    loss, rule = outer_loss_of(training, phi), outer_adam(outer_loop, phi)
    return list(descend(phi, rule, tasks, loss, steps=outer_loop.steps, rng=rng, make_steps=make_steps))


def steps_in_c(rule: UpdateRule, loss: Loss, phi: Params, order: int) -> Steps:
    steps = meta_sgd.make_outer_steps(rule, loss, phi)
    assert steps is not None
    return steps


def assert_near(found: Params, expected: Params) -> None:
    assert found.keys() == expected.keys()
    for key, value in expected.items():
        assert found[key].shape == value.shape
        assert float((found[key] - value).norm()) <= TOLERANCE * float(value.norm()), key


@needs_compiler
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"tasks": 3},
        {"smoothing": 0.2},
        {"order": 1},
        {"clip": 0.01, "tasks": 2},
        {"tasks": 9, "weight_decay": 1e-3},
    ],
    ids=["published", "several tasks", "smoothed", "first order", "clipped", "more tasks than there are"],
)
def test_phi_is_that_of_steps_in_torch(changes: dict[str, float], tasks: Tasks) -> None:
    outer_loop: MetaTraining = replace(TRAINING, **changes)  # type: ignore[arg-type]
    training = training_of(outer_loop)
    expected_states, states = (descend_by(make_steps, training, tasks) for make_steps in (torch_steps, steps_in_c))
    first = states[0].theta["theta.w2"]
    for state, expected in zip(states, expected_states, strict=True):
        assert_near(state.theta, expected.theta)
        assert state.rule_state.keys() == expected.rule_state.keys()
        if state.loss is not None:
            assert expected.loss is not None
            assert torch.allclose(state.loss, expected.loss, rtol=1e-4)
    assert float((states[-1].theta["theta.w2"] - first).abs().max()) > 1e-2  # which is far more than rounding


@needs_compiler
@pytest.mark.parametrize("march", ["x86-64-v3", "x86-64-v2"])
def test_other_instructions_give_the_same_phi(march: str, tasks: Tasks, monkeypatch: pytest.MonkeyPatch) -> None:
    library = meta_sgd.load_meta_sgd_library(march)
    if library is None or (march == "x86-64-v3" and torch.backends.cpu.get_cpu_capability() not in ("AVX2", "AVX512")):
        pytest.skip(f"this machine does not run {march}")
    training = training_of(TRAINING)
    expected = descend_by(steps_in_c, training, tasks)[-1].theta
    monkeypatch.setattr(meta_sgd, "load_meta_sgd_library", lambda: library)
    assert_near(descend_by(steps_in_c, training, tasks)[-1].theta, expected)


@needs_compiler
def test_trainings_take_steps_in_c(tasks: Tasks, monkeypatch: pytest.MonkeyPatch) -> None:
    """A training has the same losses and validation errors by steps in C and in torch."""
    training = training_of(TRAINING)
    calls: list[int] = []
    in_c = final_item(train_phi(training, tasks, Generator().manual_seed(3)))
    monkeypatch.setattr(meta_sgd, "load_meta_sgd_library", lambda: calls.append(1))  # None: there is no compiler
    in_torch = final_item(train_phi(training, tasks, Generator().manual_seed(3)))
    assert calls == [1]
    assert in_c.best_step == in_torch.best_step
    assert_near(in_c.best, in_torch.best)
    for found, expected in zip(in_c.curve[1:], in_torch.curve[1:], strict=True):
        assert found == pytest.approx(expected, rel=1e-4)


@needs_compiler
def test_a_loss_that_is_not_finite_is_returned(tasks: Tasks) -> None:
    target = tasks.data["target"].clone()
    target[2] = float("nan")
    tasks = replace(tasks, data={**tasks.data, "target": target})
    states = descend_by(steps_in_c, training_of(TRAINING), tasks)
    (first,) = next(state.names for state in states if state.loss is not None and not state.loss.isfinite().all())
    assert first == "c"


@needs_compiler
def test_trainings_that_c_lacks_are_left_to_torch(tasks: Tasks) -> None:
    def has_steps(training: Training, outer_loop: MetaTraining = TRAINING, changes: Params | None = None) -> bool:
        phi = first_phi(training, tasks) | (changes or {})
        loss = outer_loss_of(training, phi)
        return meta_sgd.make_outer_steps(outer_adam(outer_loop, phi), loss, phi) is not None

    training = training_of(TRAINING)
    assert has_steps(training)
    ridge_app = RECIPES["quick"].training("ridge").app
    assert ridge_app is not None
    double = {key: value.double() for key, value in first_phi(training, tasks).items()}
    assert not has_steps(training_of(TRAINING, OwnLoss(Nbrdf(bound=0.05))))
    assert not has_steps(training_of(TRAINING, ridge_app))
    assert not has_steps(training_of(TRAINING, rule="meta-sgd-loss"))
    assert not has_steps(training, replace(TRAINING, rates={"": 1e-3, "alpha.": 1e-4}))
    assert not has_steps(training, changes={"encoder.w": torch.zeros(1)})
    assert not has_steps(training, changes=double)
    general = general_training(training.app, RECIPES["paper"])
    encoder = general.first_phi(None, tasks, Generator()).flatten()
    loss, rule = outer_loss_of(general, encoder), outer_adam(general.outer_loop, encoder)
    assert meta_sgd.make_outer_steps(rule, loss, encoder) is None
