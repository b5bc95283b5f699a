"""Steps in C: against double precision by automatic differentiation, and against steps by torch."""

import functools
import os
import platform
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest
import torch
from torch import Generator, Tensor

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.recipes import RECIPES
from metapp.extensions.native import c_steps, nbrdf
from metapp.extensions.native import step_choice as steps_module
from metapp.extensions.native.compiler import find_compiler
from metapp.extensions.native.packing import ParameterOrder
from metapp.extensions.native.step_choice import (
    NO_COMPILING_VARIABLE,
    TORCH_CACHE_VARIABLE,
    has_tool_chain,
    make_compiled_steps,
)
from metapp.extensions.native.step_choice import choose_steps as fastest
from metapp.learned_rules import rule_of
from metapp.learning.adjoint import DrawnBatch, Loss, StepMaker, Steps, UpdateRule, torch_steps
from metapp.learning.learn import MetaParameters, after_learning, descend, expand_tasks, learn, task_loss
from metapp.learning.recipe import Adam
from metapp.learning.rules import META_EPS, fixed_adam, sgd
from metapp.learning.rules.descent import sgd_step
from metapp.learning.rules.solve import NormalEquations
from metapp.learning.task import Batch, Params
from metapp.paradigms.methods import fastest_steps
from metapp.runs.reporter import Reporter, use_reporter
from tests.learning.conftest import randn
from tests.learning.test_adjoint import assert_alike, brdf_case, value_and_grads

__all__ = ["randn"]

APP = Brdf()

TASKS, STEPS = 3, 5
IN_C = ["meta-sgd", "meta-adam", "meta-encoder", "meta-curvature"]
EPS = torch.finfo(torch.float32).eps
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="needs a C compiler: apt-get install gcc libc6-dev")


@pytest.fixture(params=["native", "x86-64-v3", "x86-64-v2"])
def form(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """Both C sources for one set of instructions, as CPUs with AVX-512, with AVX2 and without AVX run them."""
    wide = torch.backends.cpu.get_cpu_capability() in ("AVX2", "AVX512")
    march: str = request.param
    if march != "native" and not (platform.machine() in ("x86_64", "AMD64") and (wide or march == "x86-64-v2")):
        pytest.skip(f"this CPU does not run {march}")
    for module, load in ((nbrdf, "load_nbrdf_library"), (c_steps, "load_step_library")):
        library = getattr(module, load)(march)
        assert library is not None
        monkeypatch.setattr(module, load, lambda library=library: library)
    lanes: int = nbrdf.load_nbrdf_library().nbrdf_lanes()
    assert lanes == {"x86-64-v3": 8, "x86-64-v2": 4}.get(march, lanes)
    return lanes


def loss_of(batches: list[Batch], registered: bool = True) -> Loss:
    """The loss on these batches, one after the other."""
    supply = iter(batches)
    value = APP.loss if registered else lambda theta, batch, loss_parameters: APP.loss(theta, batch, loss_parameters)
    return Loss(lambda data, rng, done: DrawnBatch((), next(supply)), value)


def batch_of(rng: Generator, samples: int, tasks: int = TASKS) -> Batch:
    """Unit vectors, half vectors above the surface, cosines in (0, 1), targets."""
    vectors = torch.nn.functional.normalize(torch.randn(tasks, 2, 3, samples, generator=rng), dim=2).flatten(1, 2)
    vectors[:, 2].abs_()
    cosine = torch.rand(tasks, 1, samples, generator=rng)
    target = torch.log1p(torch.rand(tasks, 3, samples, generator=rng))
    return {"where": torch.cat([vectors, cosine], 1), "target": target}


def theta_of(rng: Generator, tasks: int = TASKS) -> Params:
    theta = APP.init(rng, tasks)
    return {key: value + 0.1 * torch.randn(value.shape, generator=rng) for key, value in theta.items()}


def learned_of(names: tuple[str, ...], rng: Generator) -> Params:
    smoothing = torch.log(0.02 + 0.1 * torch.rand(TASKS, generator=rng))
    weights = 0.5 * torch.randn(TASKS, 8, generator=rng)
    return {key: value for key, value in {"smoothing": smoothing, "weights": weights}.items() if key in names}


def double(params: Params) -> Params:
    return {key: value.double() for key, value in params.items()}


def away(actual: Tensor, expected: Tensor) -> float:
    """The difference, in units of the expected norm."""
    return float((actual.double() - expected).norm() / expected.norm())


@needs_compiler
@pytest.mark.parametrize("samples", [1, 16, 100, 128, 300, 512])
@pytest.mark.parametrize("names", [(), ("smoothing",), ("smoothing", "weights")])
def test_derivatives_in_double_precision(names: tuple[str, ...], samples: int, form: int) -> None:
    rng = Generator().manual_seed(samples)
    theta, batch, loss_parameters = theta_of(rng), batch_of(rng, samples), learned_of(names, rng)
    layout = ParameterOrder(theta)
    flat, along = layout.flatten(theta), torch.randn(TASKS, 675, generator=rng)
    gradient, losses = nbrdf.loss_gradient(flat, batch, loss_parameters)
    product, pulls = nbrdf.gradient_product(flat, batch, loss_parameters, along)

    exact = flat.double().requires_grad_()
    leaves = {key: value.double().requires_grad_() for key, value in loss_parameters.items()}
    expected = APP.loss(layout.unflatten(exact), double(batch), leaves)
    (slope,) = torch.autograd.grad(expected.sum(), exact, create_graph=True)
    bends = torch.autograd.grad((slope * along.double()).sum(), [exact, *leaves.values()])
    assert away(losses, expected.detach()) < 10 * EPS
    assert away(gradient, slope.detach()) < 10 * EPS
    assert list(pulls) == list(loss_parameters)
    for actual, bend in zip([product, *pulls.values()], bends, strict=True):
        assert away(actual, bend) < 200 * EPS  # torch in single precision: up to 70


@needs_compiler
@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1e30])
def test_values_that_are_not_finite_are_reported(bad: float) -> None:
    rng = Generator().manual_seed(2)
    theta = theta_of(rng)
    theta["b3"][1] = bad
    flat = ParameterOrder(theta).flatten(theta)
    assert torch.isfinite(nbrdf.loss_gradient(flat, batch_of(rng, 40), {})[1]).tolist() == [True, False, True]
    loss = replace(loss_of([]), draw=lambda data, rng, done: DrawnBatch(("a", "b", "c"), batch_of(rng, 40)))
    with pytest.raises(FloatingPointError, match=r"^b: the loss is not finite at step 0"):
        learn(theta, sgd({"rate": torch.ones(1)}), None, loss, steps=1, rng=rng, make_steps=fastest)


def move_parameters(rule: str, rng: Generator) -> Params:
    """A rule's hyperparameters, away from their first values."""
    single = {key: value[0] for key, value in theta_of(rng, 1).items()}
    alpha = rule_of(rule).initial_alpha(APP, single, STEPS, Adam(5e-3, beta2=0.99, eps=META_EPS))
    return {key: value + 0.02 * torch.randn(value.shape, generator=rng) for key, value in alpha.items()}


@needs_compiler
@pytest.mark.parametrize(("order", "smoothing"), [(1, 0.0), (2, 0.0), (2, 0.2)])
@pytest.mark.parametrize("rule", IN_C)
def test_meta_gradients_are_those_of_torch(rule: str, order: int, smoothing: float) -> None:
    """Rounding moves samples over the kinks of ReLU, which Adam amplifies: by torch these are up to 2e-3 away."""
    rng = Generator().manual_seed(3)
    phi = MetaParameters(
        {key: value[0] for key, value in theta_of(rng, 1).items()}, move_parameters(rule, rng)
    ).flatten()
    batches, last = [batch_of(rng, 150) for _ in range(STEPS)], batch_of(rng, 150)
    in_c_of: list[bool] = []

    def noted(rule: UpdateRule, loss: Loss, theta: Params, order: int) -> Steps:
        steps = fastest(rule, loss, theta, order)
        in_c_of.append(isinstance(getattr(steps.step, "__self__", None), c_steps._CSteps))
        return steps

    def grads(kind: Callable[[Params], Params], make_steps: StepMaker) -> Params:
        lifted = after_learning(
            replace(loss_of([]), smoothing=smoothing),
            rule_of(rule).update_rule,
            steps=STEPS,
            order=order,
            clip=0.05,
            make_steps=make_steps,
        )
        leaves = {key: value.clone().requires_grad_() for key, value in kind(phi).items()}
        value = lifted.value(leaves, ([kind(batch) for batch in batches], kind(last), None), {}).mean()
        pulls = torch.autograd.grad(value, list(leaves.values()), allow_unused=True, materialize_grads=True)
        return dict(zip(leaves, pulls, strict=True)) | {"": value.detach()}

    exact = grads(double, noted)
    assert not any(in_c_of)
    in_c_of.clear()
    found = grads(dict, noted)
    assert in_c_of == [True, True]  # of the inner steps, and of the last loss
    assert list(found) == list(exact)
    for key, value in exact.items():
        assert away(found[key], value) < 1e-2 if value.any() else not found[key].any(), key


def rules_of(theta: Params, rng: Generator) -> dict[str, UpdateRule]:
    tasks = next(iter(theta.values())).shape[0]
    return {
        "sgd": sgd({"rate": torch.tensor([0.05, 0.03])}),
        "sgd by task": sgd({"rate": torch.rand(1, tasks, generator=rng) / 10}),
        "adam": fixed_adam(Adam(1e-2, beta1=0.8, final_rate_share=0.1), theta, STEPS),
        **{name: rule_of(name).update_rule(expand_tasks(move_parameters(name, rng), tasks, 1)) for name in IN_C},
    }


@needs_compiler
@pytest.mark.parametrize("tasks", [1, TASKS])
@pytest.mark.parametrize("name", ["sgd", "sgd by task", "adam", *IN_C])
def test_fits_are_those_of_torch(name: str, tasks: int, form: int) -> None:
    rng = Generator().manual_seed(4)
    theta, batches = theta_of(rng, tasks), [batch_of(rng, 150, tasks) for _ in range(STEPS)]
    theta = {key: theta[key] for key in sorted(theta)}  # as files have them
    rule = rules_of(theta, rng)[name]
    assert c_steps.make_c_steps(rule, loss_of([]), theta, 1) is not None
    paths = [
        descend(theta, rule, None, loss_of(batches), steps=STEPS, rng=rng, make_steps=step)
        for step in (fastest, torch_steps)
    ]
    for here, torch_state in zip(*paths, strict=True):
        assert here.theta.keys() == theta.keys()
        for key, value in torch_state.theta.items():
            assert here.theta[key].shape == value.shape
            assert away(here.theta[key], value.double()) < 100 * EPS, (here.step, key)
        if here.loss is not None:
            assert torch_state.loss is not None
            assert away(here.loss, torch_state.loss.double()) < 100 * EPS


@needs_compiler
def test_settings_that_c_lacks_are_left_to_torch() -> None:
    rng = Generator().manual_seed(5)
    theta, rule, loss = theta_of(rng), sgd({"rate": torch.ones(1)}), loss_of([])
    mean, basis = (
        rule_of(name).update_rule(expand_tasks(move_parameters(name, rng), TASKS, 1))
        for name in ("meta-average", "meta-axes")
    )
    ridge = RECIPES["quick"].app_with("ridge")
    cases = {
        "mean": (mean, loss, theta),
        "basis": (basis, loss, theta),
        "double precision": (rule, loss, double(theta)),
        "another network": (rule, loss, ridge.init(rng, TASKS)),
        "another step": (rule._replace(step=lambda *arguments: sgd_step(*arguments)), loss, theta),
        "another loss": (rule, loss_of([], registered=False), theta),
        "normal equations": (rule, NormalEquations(loss.draw, loss.value, linear=APP.least_squares), theta),
    }
    assert c_steps.make_c_steps(rule, loss, theta, 1) is not None
    assert nbrdf.has_c_loss(task_loss(APP, 8, outer=True), theta)  # the same loss of other samples
    for name, case in cases.items():
        assert c_steps.make_c_steps(*case, 1) is None, name


@pytest.mark.parametrize(("module", "load"), [(nbrdf, "load_nbrdf_library"), (c_steps, "load_step_library")])
def test_fits_without_a_compiler(module: ModuleType, load: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """All goes on by torch, with the same results, whichever of the two sources cannot be compiled."""
    rng = Generator().manual_seed(6)
    theta, batches = theta_of(rng), [batch_of(rng, 64) for _ in range(STEPS)]
    rule = fixed_adam(Adam(1e-2), theta, STEPS)
    here = learn(theta, rule, None, loss_of(batches), steps=STEPS, rng=rng, make_steps=fastest)
    monkeypatch.setattr(module, load, lambda: None)
    assert c_steps.make_c_steps(rule, loss_of([]), theta, 1) is None
    torch_result = learn(theta, rule, None, loss_of(batches), steps=STEPS, rng=rng, make_steps=fastest)
    for key, value in torch_result.items():
        assert away(here[key], value.double()) < 100 * EPS


# The steps of the extension, torch's without it, and those that torch compiles


def test_steps_are_those_of_the_extension(monkeypatch: pytest.MonkeyPatch) -> None:
    offered = fastest_steps(compiles=True)
    assert isinstance(offered, functools.partial)
    assert (offered.func, offered.keywords) == (fastest, {"compiles": True})
    monkeypatch.setenv("METAPP_WITHOUT", "native")
    assert fastest_steps(compiles=True) is torch_steps


@pytest.mark.long
@pytest.mark.skipif(not (shutil.which("g++") or shutil.which("clang++")), reason="torch.compile needs g++")
def test_steps_that_torch_compiles_are_those_of_torch(randn: Callable[..., Tensor]) -> None:
    phi, mean = brdf_case("meta-curvature", randn)
    with torch._dynamo.config.patch(disable=False):  # whatever the environment said when torch read it
        assert_alike(*(value_and_grads(mean(2, make_steps), phi) for make_steps in (make_compiled_steps, torch_steps)))


def test_compiling_is_announced_once(randn: Callable[..., Tensor], monkeypatch: pytest.MonkeyPatch) -> None:
    output: list[str] = []

    class Heard(Reporter):
        def say(self, message: str) -> None:
            output.append(message)

    monkeypatch.setattr(steps_module, "has_tool_chain", lambda: True)
    monkeypatch.setattr(torch, "compile", lambda function, **_: function)  # which takes a minute
    phi, mean = brdf_case("meta-sgd", randn)  # in double precision: not in C
    steps_module._say_compiling.cache_clear()
    with use_reporter(Heard()):
        monkeypatch.setenv(NO_COMPILING_VARIABLE, "1")
        value_and_grads(mean(2, functools.partial(fastest, compiles=True)), phi)
        assert not output
        monkeypatch.delenv(NO_COMPILING_VARIABLE)
        for _ in range(2):
            value_and_grads(mean(2, functools.partial(fastest, compiles=True)), phi)
    steps_module._make_programs.cache_clear()
    assert output == ["compiling steps of the rule by torch: a minute or two, the first time"]


def test_torch_compiles_into_a_folder_of_the_user_alone(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "compile", lambda function: function)
    monkeypatch.setattr(shutil, "which", lambda name: name)
    monkeypatch.setenv(TORCH_CACHE_VARIABLE, "")
    assert has_tool_chain.__wrapped__()
    assert os.environ[TORCH_CACHE_VARIABLE] == str(cache / "torch")
    shared = cache / "shared"
    shared.mkdir()
    (shared / "code.py").touch()
    shared.chmod(0o777)
    monkeypatch.setenv(TORCH_CACHE_VARIABLE, str(shared))
    with pytest.warns(UserWarning, match=f"{shared}: .* open to others, .* {TORCH_CACHE_VARIABLE} name another place"):
        assert has_tool_chain.__wrapped__()
    assert os.environ[TORCH_CACHE_VARIABLE] != str(shared)
