"""The outer loop of Meta-SGD in C: the phi of the loop in torch, to rounding, and its draws, number by number."""

import itertools
from collections.abc import Callable, Iterator
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
from metapp.learning.learn import DescentState, check_finite_losses, descend, final_item
from metapp.learning.recipe import MetaTraining
from metapp.learning.rules import outer_adam
from metapp.learning.task import KIND_TENSOR, Params, Tasks
from metapp.paradigms.meta import Meta
from metapp.paradigms.training import train_phi

Descend = Callable[..., Iterator[DescentState]]
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


def meta_of(training: MetaTraining, app: Brdf | None = None) -> Meta:
    """Return Meta-SGD by the paper's recipe with other settings of the outer loop, of 4 inner steps of 64 samples."""
    recipe = replace(RECIPES["paper"], steps=4, samples=64, meta={"meta-sgd": training})
    return Meta.of(app or recipe.app, recipe)


def first_phi(meta: Meta, tasks: Tasks) -> Params:
    return meta.trainings[0].first_phi(None, tasks, Generator().manual_seed(1)).flatten()


def descend_in_torch(
    meta: Meta, training: MetaTraining, phi: Params, tasks: Tasks, rng: Generator, since: DescentState | None = None
) -> Iterator[DescentState]:
    """Descend the outer loss by the reference; the arguments are those of the loop in C."""
    loss = meta.trainings[0].outer_loss(meta.trainings[0].first_phi(None, tasks, Generator()))
    return descend(phi, outer_adam(training, phi), tasks, loss, steps=training.steps, rng=rng, since=since)


def descend_in_c(
    meta: Meta, training: MetaTraining, phi: Params, tasks: Tasks, rng: Generator, since: DescentState | None = None
) -> Iterator[DescentState]:
    descent = meta_sgd.descend_in_c(meta, training, phi, tasks, rng, since)
    assert descent is not None
    return descent


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
def test_phi_is_that_of_the_loop_in_torch(changes: dict[str, float], tasks: Tasks) -> None:
    training: MetaTraining = replace(TRAINING, **changes)  # type: ignore[arg-type]
    meta, rngs = meta_of(training), [Generator().manual_seed(2) for _ in range(2)]
    phi = first_phi(meta, tasks)
    expected_states = list(descend_in_torch(meta, training, phi, tasks, rngs[0]))
    states = list(descend_in_c(meta, training, phi, tasks, rngs[1]))
    assert [state.step for state in states] == [0, 30, 60, 90, 100]
    for before, state in itertools.pairwise(states):
        expected = expected_states[state.step]
        assert_near(state.theta, expected.theta)
        assert float((state.theta["theta.w2"] - phi["theta.w2"]).abs().max()) > 1e-2  # which is far more than rounding
        seen = expected_states[before.step + 1 : state.step + 1]
        assert state.names == tuple(name for one_step in seen for name in one_step.names)
        losses = torch.cat([one_step.loss for one_step in seen if one_step.loss is not None])
        assert state.loss is not None
        assert torch.allclose(state.loss, losses, rtol=1e-4)
    assert states[-1].rule_state.keys() == expected_states[-1].rule_state.keys()
    assert torch.equal(rngs[0].get_state(), rngs[1].get_state())


@needs_compiler
@pytest.mark.parametrize("march", ["x86-64-v3", "x86-64-v2"])
def test_other_instructions_give_the_same_phi(march: str, tasks: Tasks, monkeypatch: pytest.MonkeyPatch) -> None:
    library = meta_sgd.load_meta_sgd_library(march)
    if library is None or (march == "x86-64-v3" and torch.backends.cpu.get_cpu_capability() not in ("AVX2", "AVX512")):
        pytest.skip(f"this machine does not run {march}")
    meta = meta_of(TRAINING)
    phi = first_phi(meta, tasks)
    expected = final_item(descend_in_c(meta, TRAINING, phi, tasks, Generator().manual_seed(2))).theta
    monkeypatch.setattr(meta_sgd, "load_meta_sgd_library", lambda: library)
    assert_near(final_item(descend_in_c(meta, TRAINING, phi, tasks, Generator().manual_seed(2))).theta, expected)


@needs_compiler
@pytest.mark.parametrize("loops", [(descend_in_c, descend_in_torch), (descend_in_torch, descend_in_c)])
def test_either_loop_goes_on_from_the_other(loops: tuple[Descend, Descend], tasks: Tasks) -> None:
    meta = meta_of(TRAINING)
    phi = first_phi(meta, tasks)
    expected = final_item(descend_in_torch(meta, TRAINING, phi, tasks, Generator().manual_seed(2))).theta
    rng = Generator().manual_seed(2)
    cut_off = next(state for state in loops[0](meta, TRAINING, phi, tasks, rng) if state.step == 60)
    assert_near(final_item(loops[1](meta, TRAINING, phi, tasks, rng, cut_off)).theta, expected)


@needs_compiler
def test_trainings_take_the_loop_in_c(tasks: Tasks, monkeypatch: pytest.MonkeyPatch) -> None:
    """A training validates at the same steps by either loop, and has the same mean losses and validation errors."""
    meta = meta_of(TRAINING)
    calls: list[int] = []
    in_c = final_item(train_phi(meta.trainings[0], tasks, Generator().manual_seed(3)))
    monkeypatch.setattr(meta_sgd, "load_meta_sgd_library", lambda: calls.append(1))  # None: there is no compiler
    in_torch = final_item(train_phi(meta.trainings[0], tasks, Generator().manual_seed(3)))
    assert calls == [1]
    assert in_c.best_step == in_torch.best_step
    assert_near(in_c.best, in_torch.best)
    for found, expected in zip(in_c.curve[1:], in_torch.curve[1:], strict=True):
        assert found == pytest.approx(expected, rel=1e-4)


@needs_compiler
def test_a_loss_that_is_not_finite_names_its_task_and_step(tasks: Tasks) -> None:
    target = tasks.data["target"].clone()
    target[2] = float("nan")
    tasks = replace(tasks, data={**tasks.data, "target": target})
    meta, messages = meta_of(TRAINING), []
    for loop in (descend_in_c, descend_in_torch):
        descent = loop(meta, TRAINING, first_phi(meta, tasks), tasks, Generator().manual_seed(4))
        with pytest.raises(FloatingPointError, match=r"^c: the loss is not finite at step [1-9]") as caught:
            final_item(check_finite_losses(descent, every=1))
        messages.append(str(caught.value))
    assert messages[0] == messages[1]


@needs_compiler
def test_trainings_that_c_lacks_are_left_to_torch(tasks: Tasks) -> None:
    meta = meta_of(TRAINING)
    phi, rng = first_phi(meta, tasks), Generator()
    assert meta_sgd.descend_in_c(meta, TRAINING, phi, tasks, rng) is not None
    ridge_app = RECIPES["quick"].training("ridge").app
    assert ridge_app is not None
    general = RECIPES["paper"].general
    double = {key: value.double() for key, value in phi.items()}
    kinds = replace(tasks, data={**tasks.data, KIND_TENSOR: torch.zeros(6, 1, dtype=torch.uint8)})
    augmented, rates = replace(TRAINING, augment=True), replace(TRAINING, rates={"": 1e-3, "alpha.": 1e-4})
    curvature = Meta.of(RECIPES["quick"].app, RECIPES["quick"], "meta-curvature")
    cases = {
        "another loss": (meta_of(TRAINING, OwnLoss(Nbrdf(bound=0.05))), TRAINING, phi, tasks),
        "another network": (Meta(ridge_app, meta.recipe, 4, meta.learned_rule), TRAINING, phi, tasks),
        "another rule": (curvature, TRAINING, phi, tasks),
        "another training": (meta, general, phi, tasks),
        "augmentation": (meta, augmented, phi, tasks),
        "two rates": (meta, rates, phi, tasks),
        "an encoder": (meta, TRAINING, phi | {"encoder.w": torch.zeros(1)}, tasks),
        "double precision": (meta, TRAINING, double, tasks),
        "several kinds": (meta, TRAINING, phi, kinds),
    }
    for name, case in cases.items():
        assert meta_sgd.descend_in_c(*case, rng) is None, name
