"""Differentiating through learning: closed forms, an unrolled graph and finite differences must agree with it."""

import gc
import weakref
from collections.abc import Callable, Sequence

import pytest
import torch
from torch import Generator, Tensor
from torch.utils._pytree import tree_map

from metapp.apps.brdf.app import Brdf
from metapp.learned_rules import rule_of
from metapp.learning.adjoint import (
    Loss,
    StepMaker,
    UpdateRule,
    add_smoothing,
    at_step,
    learn_differentiably,
    torch_steps,
)
from metapp.learning.app import stack_tasks
from metapp.learning.learn import MetaParameters, after_learning, expand_tasks, task_loss
from metapp.learning.recipe import Adam
from metapp.learning.rounding import smooth_absolute
from metapp.learning.rules import META_EPS, fixed_adam, sgd
from metapp.learning.task import Batch, Params
from metapp.paradigms.trainings import encoder_prediction
from tests.learning.parabolas import refuse_to_draw
from tests.paradigms.small import FEATURE_NETWORK, SMALL_APPLICATIONS, applicable_rules, small_app

APP = Brdf()

TASKS, STEPS, SAMPLES = 3, 4, 24
ON_MATRICES = applicable_rules(APP)
OTHERS = [("brdf", "meta-encoder", True), (FEATURE_NETWORK, "ridge", False), ("illumination", "meta-lgd", False)]


def parabola(params: Params, batch: Batch, loss_parameters: Params) -> Tensor:
    """(x - c)^T A (x - c) / 2, times a learned factor where there is one; [T]."""
    away = params["x"] - batch["c"]
    value = 0.5 * (away * (batch["A"] @ away[..., None])[..., 0]).sum(-1)
    return value * torch.exp(loss_parameters["factor"]) if loss_parameters else value


PARABOLA, BRDF = Loss(refuse_to_draw, parabola), Loss(refuse_to_draw, APP.loss)


def symmetric(matrices: Tensor) -> Tensor:
    return matrices @ matrices.mT


def brdf_batch(randn: Callable[..., Tensor]) -> Batch:
    """Random unit vectors, cosines in (0, 1) and targets."""
    vectors = torch.nn.functional.normalize(randn(TASKS, 2, 3, SAMPLES), dim=2).flatten(1, 2)
    cosine = torch.sigmoid(randn(TASKS, 1, SAMPLES))
    return {"where": torch.cat([vectors, cosine], 1), "target": torch.log1p(randn(TASKS, 3, SAMPLES).abs())}


def brdf_phi(rule: str, randn: Callable[..., Tensor], steps: int = STEPS) -> Params:
    """A random start and a rule away from its initial quantities, float64, flat."""
    theta = {key: value[0].double() for key, value in APP.init(Generator().manual_seed(2), 1).items()}
    alpha = {
        key: value + 0.05 * randn(*value.shape)
        for key, value in rule_of(rule).initial_alpha(APP, theta, steps, Adam(5e-3, beta2=0.99, eps=META_EPS)).items()
    }
    return MetaParameters(theta, alpha).flatten()


def brdf_case(rule: str, randn: Callable[..., Tensor]) -> tuple[Params, Callable[..., Callable[[Params], Tensor]]]:
    """phi, and options -> the mean loss after STEPS steps by it; the same batches for all options."""
    phi, last = brdf_phi(rule, randn), brdf_batch(randn)
    batches = [brdf_batch(randn) for _ in range(STEPS)]

    def mean(order: int, make_steps: StepMaker | None = torch_steps) -> Callable[[Params], Tensor]:
        def unrolled_mean(phi: Params) -> Tensor:
            start = MetaParameters.unflatten(phi)
            learned = rule_of(rule).update_rule(expand_tasks(start.alpha, TASKS, 1))
            return APP.loss(
                learn_unrolled(expand_tasks(start.theta, TASKS, 0), learned, batches, BRDF, order), last, {}
            ).mean()

        if make_steps is None:  # one unrolled graph
            return unrolled_mean
        lifted = after_learning(BRDF, rule_of(rule).update_rule, steps=STEPS, order=order, make_steps=make_steps)
        return lambda phi: lifted.value(phi, (batches, last, None), {}).mean()

    return phi, mean


def parabolas(randn: Callable[..., Tensor], count: int, tasks: int = TASKS) -> list[Batch]:
    return [{"A": symmetric(randn(tasks, 3, 3)) / 3, "c": randn(tasks, 3)} for _ in range(count)]


def learn_unrolled(theta: Params, rule: UpdateRule, batches: Sequence[Batch], loss: Loss, order: int) -> Params:
    """What learn_through stands for: one graph through all steps."""
    state = rule.init(theta)
    for i, batch in enumerate(batches):
        alpha = at_step(rule.alpha, i)
        loss_parameters = {key[5:]: value for key, value in alpha.items() if key.startswith("loss.")}
        total = loss.value(theta, batch, loss_parameters).sum()
        grads = torch.autograd.grad(total, list(theta.values()), create_graph=order == 2, retain_graph=True)
        theta, state = rule.step(alpha, theta, dict(zip(theta, grads, strict=True)), state)
    return theta


def value_and_grads(function: Callable[[Params], Tensor], params: Params) -> tuple[Tensor, Params]:
    leaves = {key: value.detach().clone().requires_grad_() for key, value in params.items()}
    value = function(leaves)
    grads = torch.autograd.grad(value, list(leaves.values()), allow_unused=True, materialize_grads=True)
    return value.detach(), dict(zip(leaves, grads, strict=True))


def assert_alike(actual: tuple[Tensor, Params], expected: tuple[Tensor, Params]) -> None:
    """Values and their gradients."""
    torch.testing.assert_close(actual, expected, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("steps", [1, 2, 5])
@pytest.mark.parametrize("order", [1, 2])
def test_derivative_in_one_dimension_agrees_with_the_closed_form(order: int, steps: int) -> None:
    curvature = torch.tensor([0.5, 2.0], dtype=torch.float64)
    target, rate = torch.tensor([1.0, -3.0], dtype=torch.float64), 0.3
    away, keep = 0.7 - target, 1 - rate * curvature
    batch = {"A": curvature[:, None, None], "c": target[:, None]}
    phi = {"theta.x": torch.full((1,), 0.7).double(), "alpha.rate": torch.full((1, 1), rate, dtype=torch.float64)}
    lifted = after_learning(PARABOLA, sgd, steps=steps, order=order)
    value, grads = value_and_grads(lambda phi: lifted.value(phi, ([batch] * steps, batch, None), {}).sum(), phi)
    # x_K - c = keep^K (x_0 - c), and the loss is A (x_K - c)^2 / 2
    torch.testing.assert_close(value, (0.5 * curvature * (keep**steps * away) ** 2).sum())
    if order == 2:
        start = curvature * keep ** (2 * steps) * away
        step = -steps * curvature**2 * keep ** (2 * steps - 1) * away**2
    else:  # each step's gradient is a constant: d x_K / d x_0 = 1, d x_K / d rate = -sum of the gradients
        start = curvature * keep**steps * away
        step = -(curvature**2) * keep**steps * away**2 * sum(keep**i for i in range(steps))
    torch.testing.assert_close(grads["theta.x"], start.sum()[None])
    torch.testing.assert_close(grads["alpha.rate"], step.sum().reshape(1, 1))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("rule", ON_MATRICES)
def test_derivative_agrees_with_an_unrolled_graph(rule: str, order: int, randn: Callable[..., Tensor]) -> None:
    phi, mean = brdf_case(rule, randn)
    expected = value_and_grads(mean(order, make_steps=None), phi)
    value, grads = value_and_grads(mean(order), phi)
    assert_alike((value, grads), expected)
    for key, grad in grads.items():  # every quantity matters; order 1 does not see the loss's own
        assert (float(grad.abs().max()) > 0) == (order == 2 or not key.startswith("alpha.loss.")), key


@pytest.mark.parametrize(("kind", "rule", "encoded"), [*(("brdf", rule, False) for rule in ON_MATRICES), *OTHERS])
def test_derivatives_agree_with_finite_differences(
    kind: str, rule: str, encoded: bool, randn: Callable[..., Tensor]
) -> None:
    """Through the steps of every rule, in float64, along a random direction of each parameter of phi."""
    app, learned, start = small_app(kind), rule_of(rule), encoder_prediction(small_app(kind)) if encoded else None
    inner = learned.loss(app, task_loss(app, 16))
    loss = after_learning(inner, learned.update_rule, steps=3, order=2, prediction=start)
    drawn = loss.draw(stack_tasks(app, SMALL_APPLICATIONS[app.name].tasks()[:2]), Generator().manual_seed(1), 1.0).batch
    batch = tree_map(lambda leaf: leaf.double() if isinstance(leaf, Tensor) else leaf, drawn)
    theta = {key: value[0].double() for key, value in app.init(Generator().manual_seed(2), 1).items()}
    encoder = {key: value.double() for key, value in app.init_encoder(Generator().manual_seed(3)).items()}
    alpha = learned.initial_alpha(app, theta, 3, Adam(5e-3, beta2=0.99, eps=1e-3))
    alpha = {key: value + 0.05 * randn(*value.shape) for key, value in alpha.items()}
    phi = (MetaParameters({}, alpha, encoder) if encoded else MetaParameters(theta, alpha)).flatten()
    _, grads = value_and_grads(lambda phi: loss.value(phi, batch, {}).mean(), phi)
    assert any(grad.any() for key, grad in grads.items() if not key.startswith("alpha."))
    for key, value in phi.items():
        direction = 1e-6 * torch.nn.functional.normalize(randn(*value.shape).flatten(), dim=0).reshape(value.shape)
        above, below = (loss.value(phi | {key: value + sign * direction}, batch, {}).mean() for sign in (1, -1))
        torch.testing.assert_close((grads[key] * direction).sum(), (above - below) / 2, rtol=1e-4, atol=1e-13, msg=key)


def test_steps_beyond_the_last_quantities(randn: Callable[..., Tensor]) -> None:
    (batch,) = parabolas(randn, 1, tasks=1)
    rates, start = 0.1 * randn(2, 3), randn(3)
    few = {"theta.x": start, "alpha.rate.x": rates}
    many = {"theta.x": start, "alpha.rate.x": rates[[0, 1, 1, 1, 1]]}
    lifted = after_learning(PARABOLA, sgd, steps=5, order=2)
    found, (value, grads) = (
        value_and_grads(lambda phi: lifted.value(phi, ([batch] * 5, batch, None), {}).sum(), phi) for phi in (few, many)
    )
    rate = grads["alpha.rate.x"]
    assert_alike(found, (value, grads | {"alpha.rate.x": torch.stack([rate[0], rate[1:].sum(0)])}))
    assert at_step({"rate": rates}, 7)["rate"] is not rates
    assert torch.equal(at_step({"rate": rates}, 7)["rate"], rates[1])


@pytest.mark.parametrize(("order", "evaluations"), [(1, 12), (2, 24)])
def test_no_graph_is_kept_between_steps(order: int, evaluations: int, randn: Callable[..., Tensor]) -> None:
    """Every step's activations are gone before the next step computes its own, on the way there and back.

    Order 1 keeps each step's gradient, a constant, instead of computing it anew, and no batch: those may be large.
    """
    activations: list[weakref.ref] = []
    alive: list[int] = []

    def value(params: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        alive.append(sum(reference() is not None for reference in activations))
        hidden = torch.tanh(params["x"][..., None] * batch["c"])
        activations.append(weakref.ref(hidden.untyped_storage()))
        return (hidden * hidden).mean((1, 2))

    batches = [{"c": randn(TASKS, 3, 50)} for _ in range(12)]
    theta = {"x": randn(TASKS, 3).requires_grad_()}
    rule = sgd({"rate": torch.full((1, TASKS), 0.1).double().requires_grad_()})
    final = learn_differentiably(theta, rule, batches, Loss(refuse_to_draw, value), order=order)["x"]
    kept = [weakref.ref(batch["c"]) for batch in batches]
    del batches
    assert sum(reference() is not None for reference in kept) == (12 if order == 2 else 0)
    assert not any(reference() is not None for reference in activations)
    torch.autograd.grad(final.sum(), [theta["x"], rule.alpha["rate"]])
    assert len(alive) == evaluations
    assert max(alive) == 0


def test_batches_are_gone_with_the_result_that_was_learned_on_them(randn: Callable[..., Tensor]) -> None:
    """Reference counts alone free them, also where a rule leaves a parameter as it is, or keeps one in its state."""

    def step(alpha: Params, theta: Params, gradient: Params, state: Params) -> tuple[Params, Params]:
        moved = theta["x"] - alpha["rate"] * gradient["x"]
        return {"x": moved, "constant": theta["constant"]}, {"last": moved}

    rule = UpdateRule({"rate": torch.full((1, 1), 0.1).double()}, lambda theta: {"last": theta["x"]}, step)
    theta = {"x": randn(1, 3).requires_grad_(), "constant": randn(1, 3).requires_grad_()}
    batches = [{"A": symmetric(randn(1, 3, 3)), "c": randn(1, 3)} for _ in range(3)]
    batch = weakref.ref(batches[0]["c"])
    gc.disable()
    try:
        final = learn_differentiably(theta, rule, batches, PARABOLA, order=2)
        torch.autograd.grad(final["x"].sum() + final["constant"].sum(), list(theta.values()))
        del final, batches
        assert batch() is None
    finally:
        gc.enable()


@pytest.mark.parametrize("order", [1, 2])
def test_derivative_of_a_rule_that_tasks_share_agrees_with_an_unrolled_graph(
    order: int, randn: Callable[..., Tensor]
) -> None:
    """Adam's products of betas then have no task axis."""
    start = {"x": randn(TASKS, 3), "beta1": torch.full((1,), 0.8).double()}
    batches = parabolas(randn, STEPS)
    adam = fixed_adam(Adam(1e-2), start, STEPS)
    alpha = {key: value.double() for key, value in adam.alpha.items()}

    def final(leaves: Params, descend: Callable[..., Params]) -> Tensor:
        rule = adam._replace(alpha=alpha | {"beta1": leaves["beta1"]})
        return descend({"x": leaves["x"]}, rule, batches, PARABOLA, order=order)["x"].square().sum()

    found = value_and_grads(lambda leaves: final(leaves, learn_differentiably), start)
    assert_alike(found, value_and_grads(lambda leaves: final(leaves, learn_unrolled), start))
    assert found[1]["beta1"].any()


def test_unused_parameters_get_no_gradient(randn: Callable[..., Tensor]) -> None:
    """A parameter that the loss does not see."""
    batches = parabolas(randn, 3)
    theta = {"x": randn(TASKS, 3).requires_grad_(), "unseen": randn(TASKS, 2).requires_grad_()}
    rule = sgd({"rate": torch.full((1, TASKS), 0.1).double()})
    final = learn_differentiably(theta, rule, batches, PARABOLA, order=2)
    assert torch.equal(final["unseen"], theta["unseen"])
    x, unseen = torch.autograd.grad(final["x"].sum(), list(theta.values()), allow_unused=True, materialize_grads=True)
    assert x.any()
    assert not unseen.any()


@pytest.mark.parametrize("steps", [0, 3])
def test_second_backward_pass_gives_the_same_gradient(steps: int, randn: Callable[..., Tensor]) -> None:
    """This holds with retain_graph, and after no step, where theta is the initialisation."""
    batch = {"A": symmetric(randn(1, 3, 3)), "c": randn(1, 3)}
    theta = {"x": randn(1, 3).requires_grad_()}
    rule = sgd({"rate": torch.full((1, 1), 0.1).double()})
    final = learn_differentiably(theta, rule, [batch] * steps, PARABOLA, order=2)["x"].sum()
    (first,) = torch.autograd.grad(final, theta["x"], retain_graph=True)
    (second,) = torch.autograd.grad(final, theta["x"])
    torch.testing.assert_close(first, second)
    assert steps or torch.equal(first, torch.ones_like(first))


def smoothed_median(params: Params, batch: Batch, loss_parameters: Params) -> Tensor:
    """The mean distance of x from samples, [T], smoothed if the loss parameter says so."""
    return smooth_absolute(params["x"] - batch["samples"], loss_parameters).mean(1)


@pytest.mark.parametrize(("smoothing", "curvature"), [(0.0, 0.0), (0.02, 1.0), (0.1, 1.0)])
def test_smoothed_second_derivatives_see_the_curvature_of_means_of_distances(
    smoothing: float, curvature: float
) -> None:
    """Mean distances from samples that are uniform in [-1, 1] are (1 + x^2) / 2; of |d| itself, autograd sees none."""
    loss, rate = Loss(refuse_to_draw, smoothed_median, smoothing=smoothing), 0.25
    samples, x = torch.linspace(-1, 1, 10_001)[None], torch.tensor([[0.3]], requires_grad=True)
    theta = learn_differentiably({"x": x}, sgd({"rate": torch.tensor([rate])}), [{"samples": samples}], loss, order=2)
    assert theta["x"].item() == pytest.approx(0.3 - rate * 0.3, abs=1e-3)  # the step itself knows of no smoothing
    (derivative,) = torch.autograd.grad(theta["x"], x)
    assert float(derivative) == pytest.approx(1 - rate * curvature, abs=rate * smoothing**2 + 1e-3)


def test_learned_smoothing_goes_before_that_of_second_derivatives() -> None:
    loss_parameters = {"smoothing": torch.zeros(2)}
    theta, loss = {"x": torch.zeros(2, 1)}, Loss(refuse_to_draw, smoothed_median, smoothing=0.2)
    assert add_smoothing(loss, loss_parameters, theta)["smoothing"].tolist() == [0, 0]
    assert add_smoothing(loss, {}, theta)["smoothing"].exp().tolist() == pytest.approx([0.2, 0.2])
    assert add_smoothing(Loss(refuse_to_draw, smoothed_median), {}, theta) == {}
