"""The guard of learned rules: on parabolas, whose descent is known, and on materials."""

import math
from collections.abc import Iterator

import pytest
import torch
from torch import Generator, Tensor

from metapp.apps.brdf.app import Brdf
from metapp.learned_rules import rule_of
from metapp.learning.adjoint import Loss, UpdateRule
from metapp.learning.guard import descend_with_guard
from metapp.learning.learn import DescentState, descend, expand_tasks, final_item, learn, task_loss
from metapp.learning.recipe import Adam, Guard
from metapp.learning.rules import fixed_adam, sgd
from metapp.learning.task import Params, Tasks
from tests.learning.parabolas import EXACT_LOSS, NAMES, NOISY_LOSS, parabola_loss

APP = Brdf()

ADAM = Adam(0.1, beta1=0.5, beta2=0.9)
GUARD = Guard(ADAM)
STEPS = 12
SLOW, FAST = 0.01, 0.5  # rates of a descent on parabolas of curvature 1
DIVERGING = 2.5  # each step makes the error 1.5 times as large
MIXED = (FAST, DIVERGING, FAST, DIVERGING, FAST)


@pytest.fixture
def start(rng: Generator) -> Params:
    return {"x": torch.randn(len(NAMES), 3, generator=rng, dtype=torch.float64)}


def rates(*step_rates: float) -> UpdateRule:
    """A descent of a rate of its own for each task."""
    return sgd({"rate": torch.tensor([step_rates], dtype=torch.float64)})


def at_steps(*step_rates: float) -> UpdateRule:
    """A descent of a rate of its own for each step, the same for all tasks."""
    return sgd({"rate": torch.tensor(step_rates, dtype=torch.float64)[:, None].expand(-1, len(NAMES))})


def loss_of(theta: Params, tasks: Tasks) -> Tensor:
    return parabola_loss(theta, {"c": tasks.data["c"][tasks.rows]}, {})


def fit(
    rule: UpdateRule, start: Params, tasks: Tasks, *, loss: Loss = EXACT_LOSS, guard: Guard = GUARD
) -> tuple[DescentState, Params]:
    """A guarded fit, and the rule's own."""
    path = list(guarded_descent(start, rule, tasks, loss, Generator().manual_seed(1), guard))
    alone = final_item(descend(start, rule, tasks, loss, steps=STEPS, rng=Generator().manual_seed(1)))
    assert [now.step for now in path] == [*range(STEPS + 1), STEPS]
    assert torch.equal(path[-2].theta["x"], alone.theta["x"]) or alone.theta["x"].isnan().any()
    return path[-1], alone.theta


def guarded_descent(
    start: Params, rule: UpdateRule, tasks: Tasks, loss: Loss, rng: Generator, guard: Guard
) -> Iterator[DescentState]:
    return descend_with_guard(start, rule, tasks, loss, rng=rng, guard=guard, steps=STEPS)


def test_guard_that_does_not_act_changes_nothing(start: Params, tasks: Tasks) -> None:
    """Results are equal to the last digit, and so are the draws of the next fit."""
    found, alone = fit(rates(*MIXED), start, tasks, loss=NOISY_LOSS)
    assert found.guarded.tolist() == [False, True, False, True, False]
    assert torch.equal(found.theta["x"][::2], alone["x"][::2])
    guarded, plain = Generator().manual_seed(1), Generator().manual_seed(1)
    rule = rates(*[DIVERGING] * 5)
    final_item(guarded_descent(start, rule, tasks, NOISY_LOSS, guarded, GUARD))
    learn(start, rule, tasks, NOISY_LOSS, steps=STEPS, rng=plain)
    assert torch.equal(guarded.get_state(), plain.get_state())


def test_a_diverged_fit_goes_on_by_adam_from_its_initialisation(start: Params, tasks: Tasks) -> None:
    """Which stays where Adam does not help."""
    adam = learn(start, fixed_adam(ADAM, start, STEPS), tasks, EXACT_LOSS, steps=STEPS, rng=Generator())
    for guard, expected in ((GUARD, adam), (Guard(Adam(1e3)), start)):
        found, _ = fit(rates(*[DIVERGING] * 5), start, tasks, guard=guard)
        assert found.guarded.all()
        assert torch.equal(found.theta["x"], expected["x"])


@pytest.mark.parametrize("bad", [1e200, math.nan])
def test_parameters_that_overflow_are_replaced(bad: float, start: Params, tasks: Tasks) -> None:
    rule = rates(FAST, bad, FAST, FAST, FAST)
    with pytest.raises(FloatingPointError, match=r"^chalk: "):
        learn(start, rule, tasks, EXACT_LOSS, steps=STEPS, rng=Generator())
    found, alone = fit(rule, start, tasks)
    assert found.guarded.tolist() == [False, True, False, False, False]
    assert (loss_of(found.theta, tasks) < loss_of(start, tasks)).all()
    assert torch.equal(found.theta["x"][2:], alone["x"][2:])


def test_an_initialisation_that_is_not_finite_is_refused(start: Params, tasks: Tasks) -> None:
    start["x"][2] = math.nan
    with pytest.raises(FloatingPointError, match=r"^felt: the loss is not finite at step 0;"):
        fit(rates(*[FAST] * 5), start, tasks)


def test_a_loss_that_hardly_falls_is_doubtful(start: Params, tasks: Tasks) -> None:
    """The loss ends at (1 - rate)^(2 steps) times the loss of the initialisation."""
    rule, share = rates(*[SLOW] * 5), (1 - SLOW) ** (2 * STEPS)
    for fall, acts in ((1.0, False), (share + 1e-6, False), (share - 1e-6, True)):
        found, alone = fit(rule, start, tasks, guard=Guard(ADAM, fall))
        assert found.guarded.tolist() == [acts] * 5
        assert (loss_of(found.theta, tasks) < loss_of(alone, tasks)).tolist() == [acts] * 5


def climb(step: int, factor: float) -> list[float]:
    """Rates of which that of one step makes the loss `factor` times as large; of all others half as large."""
    fall = 1 - math.sqrt(0.5)
    return [1 + math.sqrt(factor) if i == step else fall for i in range(STEPS)]


@pytest.mark.parametrize(
    ("step", "factor", "rise", "acts"),
    [(7, 3.0, 2.9, True), (7, 3.0, 3.1, False), (7, 3.0, math.inf, False), (3, 3.0, 2.0, False), (5, 3.0, 2.0, True)],
)
def test_a_loss_that_rises_late_is_doubtful(
    step: int, factor: float, rise: float, acts: bool, start: Params, tasks: Tasks
) -> None:
    found, alone = fit(at_steps(*climb(step, factor)), start, tasks, guard=Guard(ADAM, max_rise_factor=rise))
    expected = factor * 0.5 ** (STEPS - 1) * loss_of(start, tasks)
    torch.testing.assert_close(loss_of(alone, tasks), expected)
    if acts:
        assert (loss_of(found.theta, tasks) <= expected).all()
        assert found.guarded.any()
    else:
        assert not found.guarded.any()
        assert torch.equal(found.theta["x"], alone["x"])


def test_learned_loss_parameters_hide_nothing(start: Params, tasks: Tasks) -> None:
    """What steps descend falls, as its learned scale does, but the loss itself rises; and the other way round."""
    for rate, scales, acts in ((DIVERGING, (1.0, 1e-30), True), (FAST, (1.0, 1e30), False)):
        rule = rates(*[rate] * 5)
        scale = torch.linspace(0, 1, STEPS, dtype=torch.float64)[:, None].expand(-1, 5)
        scale = scales[0] * (scales[1] / scales[0]) ** scale
        reweighted = rule._replace(
            alpha=rule.alpha | {"loss.scale": scale},
            step=lambda alpha, theta, grads, state, rate=rate: (
                {"x": theta["x"] - rate * grads["x"] / alpha["loss.scale"][:, None]},
                state,
            ),
        )
        found, _ = fit(reweighted, start, tasks)
        assert found.guarded.tolist() == [acts] * 5


@pytest.mark.parametrize("rule", ["meta-sgd", "meta-average", "meta-curvature"])
@pytest.mark.parametrize("rate", [1e-3, 1e3])
def test_every_rule_is_guarded(rule: str, rate: float, rng: Generator) -> None:
    """Compositions and tail averaging, too: a good rate stays as it is, an absurd one ends below the initialisation."""
    where, target = torch.rand(4, 2048, 7, generator=rng), torch.rand(4, 2048, 3, generator=rng)
    materials = Tasks(NAMES[:4], {"where": where, "target": target}, torch.arange(4))
    theta = APP.init(rng, 4)
    learned = rule_of(rule)
    alpha = learned.initial_alpha(APP, {key: value[0] for key, value in theta.items()}, STEPS, Adam(rate))
    learned_rule, loss = learned.update_rule(expand_tasks(alpha, 4, 1)), task_loss(APP, 512)
    draws = [Generator().manual_seed(2) for _ in range(2)]
    found = final_item(guarded_descent(theta, learned_rule, materials, loss, draws[0], Guard(Adam(1e-3))))
    alone = final_item(descend(theta, learned_rule, materials, loss, steps=STEPS, rng=draws[1])).theta
    assert found.guarded.tolist() == [rate > 1] * 4
    judged = loss.draw(materials, Generator().manual_seed(2), 1.0).batch
    assert (APP.loss(found.theta, judged, {}) < APP.loss(theta, judged, {})).all()
    if rate < 1:
        assert all(torch.equal(found.theta[key], value) for key, value in alone.items())
