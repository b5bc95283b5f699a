"""learn and the combinators that lift losses."""

import math
import weakref
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Generator, Tensor

from metapp.apps.brdf.app import Brdf
from metapp.learned_rules import rule_of
from metapp.learning.adjoint import DrawnBatch
from metapp.learning.app import stack_tasks
from metapp.learning.learn import (
    DescentState,
    EncoderPrediction,
    MetaParameters,
    after_encoding,
    after_learning,
    check_finite_losses,
    clip_task_gradients,
    descend,
    expand_tasks,
    final_item,
    learn,
    over_tasks,
    task_loss,
)
from metapp.learning.recipe import Adam
from metapp.learning.rules import fixed_adam, sgd
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec, problems_of
from tests.learning.parabolas import EXACT_LOSS, NAMES, NOISY_LOSS, parabola_loss
from tests.paradigms.small import applicable_rules

APP = Brdf()


@pytest.fixture
def materials(rng: Generator) -> Tasks:
    """Random samples that no real material has, float64."""
    where = torch.rand(4, 64, 7, generator=rng, dtype=torch.float64)
    target = torch.rand(4, 64, 3, generator=rng, dtype=torch.float64)
    return Tasks(NAMES[:4], {"where": where, "target": target}, torch.arange(4))


class Plain(Brdf):
    """An application that takes tasks as they are."""

    def prepare(self, task: Task) -> Params:
        return task.data


def zeros(tasks: Tasks) -> Params:
    return {"x": torch.zeros(len(tasks), 3, dtype=torch.float64)}


def rate(value: float) -> Params:
    return {"rate": torch.full((1,), value, dtype=torch.float64)}


@pytest.fixture
def phi() -> Params:
    """A random initialisation and a rate of 0.1, flat."""
    return MetaParameters({"x": torch.randn(3, generator=Generator().manual_seed(0)).double()}, rate(0.1)).flatten()


# learn


@pytest.mark.parametrize("steps", [0, 2, 20])
def test_descents_agree_with_the_closed_form_and_keep_the_initialisation(
    steps: int, tasks: Tasks, rng: Generator
) -> None:
    theta = {"x": torch.randn(5, 3, dtype=torch.float64).requires_grad_()}
    before = theta["x"].detach().clone()
    final = learn(theta, sgd(rate(0.1)), tasks, EXACT_LOSS, steps=steps, rng=rng)["x"]
    torch.testing.assert_close(final, tasks.data["c"] + 0.9**steps * (before - tasks.data["c"]))
    assert torch.equal(theta["x"], before)
    assert theta["x"].grad is None
    assert not final.requires_grad
    assert torch.equal(final, before) is (steps == 0)


@pytest.mark.parametrize("rule", applicable_rules(APP))
def test_tasks_side_by_side_equal_each_alone(rule: str, materials: Tasks, rng: Generator) -> None:
    """With a generator for each task, its fit does not depend on the tasks beside it."""
    steps, count = 6, len(materials)
    start = {key: value.double() for key, value in APP.init(rng, count).items()}
    alpha = rule_of(rule).initial_alpha(
        APP, {key: value[0] for key, value in start.items()}, steps, Adam(5e-3, beta2=0.99)
    )

    def fit(rows: range) -> Params:
        theta, own = (
            {key: value[rows] for key, value in start.items()},
            rule_of(rule).update_rule(expand_tasks(alpha, len(rows), 1)),
        )
        draws = tuple(Generator().manual_seed(row) for row in rows)
        return learn(theta, own, materials.select(rows), task_loss(APP, 16), steps=steps, rng=draws)

    together, alone = fit(range(count)), [fit(range(i, i + 1)) for i in range(count)]
    joined = {key: torch.cat([result[key] for result in alone]) for key in start}
    torch.testing.assert_close(together, joined, rtol=1e-9, atol=1e-12)
    assert not any(torch.equal(joined[key][i], value[i]) for key, value in start.items() for i in range(count))


def test_a_descent_yields_its_initialisation_and_each_step(tasks: Tasks, rng: Generator) -> None:
    """It yields the parameters after each step and the loss before it, and draws nothing before a step is due."""
    drawn: list[float] = []
    loss = replace(EXACT_LOSS, draw=lambda tasks, rng, done: drawn.append(done) or EXACT_LOSS.draw(tasks, rng, done))
    descent = descend(zeros(tasks), sgd(rate(0.5)), tasks, loss, steps=3, rng=rng)
    for i, now in enumerate(descent):
        assert drawn == [k / 3 for k in range(i)]
        assert now.step == i
        torch.testing.assert_close(now.theta["x"], (1 - 0.5**i) * tasks.data["c"])
        assert (now.loss is None, now.names) == (i == 0, NAMES if i else ())
        if now.loss is not None:
            torch.testing.assert_close(now.loss, 0.5 * (0.5 ** (i - 1) * tasks.data["c"]).square().sum(1))
    assert len(drawn) == 3


def test_a_descent_goes_on_from_any_of_its_steps(tasks: Tasks) -> None:
    start, rule = zeros(tasks), fixed_adam(Adam(0.1, final_rate_share=0.0), zeros(tasks), 6)
    expected = learn(start, rule, tasks, NOISY_LOSS, steps=6, rng=Generator().manual_seed(1))
    rng = Generator().manual_seed(1)
    middle = next(now for now in descend(start, rule, tasks, NOISY_LOSS, steps=6, rng=rng) if now.step == 4)
    others = descend(
        {}, rule, tasks, NOISY_LOSS, steps=6, rng=rng, since=DescentState(4, middle.theta, middle.rule_state)
    )
    *_, final = others
    assert torch.equal(final.theta["x"], expected["x"])


@pytest.mark.parametrize(("every", "expected"), [(0, [0]), (1, list(range(10))), (4, [0, 4, 8, 9]), (50, [0, 9])])
def test_finite_losses_are_checked_every_few_steps_and_at_the_last(every: int, expected: list[int]) -> None:
    """Counted from 0: every so many, and the last, unless it is the first alone."""
    for bad in range(10):
        losses = [torch.tensor([(math.nan, math.inf)[bad % 2] if i == bad else 1.0]) for i in range(10)]
        descent = [
            DescentState(0, {}, {}),
            *(DescentState(i + 1, {}, {}, loss, ("felt",)) for i, loss in enumerate(losses)),
        ]
        message = rf"^felt: the loss is not finite at step {bad}; lower the learning rate or clip earlier\.$"
        with pytest.raises(FloatingPointError, match=message) if bad in expected else nullcontext():
            final_item(check_finite_losses(iter(descent), every))


# Combinators


def test_equal_applications_have_one_loss_that_holds_neither() -> None:
    """Compiled steps are found by the loss; pictures that an application made last are freed with it."""
    app = Plain()
    assert task_loss(app, 5) is task_loss(Plain(), 5) is not task_loss(Plain(conserve=True), 5)
    alive = weakref.ref(app)
    del app
    assert alive() is None


def test_over_tasks_draws_without_replacement(tasks: Tasks, rng: Generator) -> None:
    loss, counts = over_tasks(EXACT_LOSS, count=3), dict.fromkeys(NAMES, 0)
    for _ in range(300):
        names = loss.draw(tasks, rng, 1.0).names
        assert len(names) == len(set(names)) == 3
        for name in names:
            counts[name] += 1
    assert all(abs(count - 180) < 5 * math.sqrt(300 * 0.6 * 0.4) for count in counts.values())
    assert sorted(over_tasks(EXACT_LOSS, count=9).draw(tasks, rng, 1.0).names) == list(NAMES)  # no more than there are
    subset = tasks.select([1, 4])
    assert {name for _ in range(20) for name in loss.draw(subset, rng, 1.0).names} == {"chalk", "paper"}


def test_over_tasks_draws_as_many_of_each_kind(tasks: Tasks, rng: Generator) -> None:
    """One of five tasks is of another kind, and it is one of the two that are drawn."""
    several = replace(tasks, data=tasks.data | {"kind": torch.tensor([[name == "chalk"] for name in NAMES])})
    loss = over_tasks(EXACT_LOSS, count=1)
    names = [loss.draw(several, rng, 1.0).names[0] for _ in range(400)]
    assert abs(names.count("chalk") - 200) < 5 * 10
    assert set(names) == set(NAMES)
    assert sorted(over_tasks(EXACT_LOSS, count=9).draw(several, rng, 1.0).names) == list(NAMES)


def test_over_tasks_trains_by_sight_of_augmented_tasks(tasks: Tasks, rng: Generator) -> None:
    def augment(picked: Tasks, rng: Generator) -> Tasks:
        names = tuple(f"twice {name}" for name in picked.selected_names)
        return Tasks(names, {"c": 2 * picked.data["c"][picked.rows]}, torch.arange(len(picked)))

    drawn = over_tasks(EXACT_LOSS, count=2, augment=augment).draw(tasks, rng, 1.0)
    for name, c in zip(drawn.names, drawn.batch["c"], strict=True):
        assert torch.equal(c, 2 * tasks.data["c"][NAMES.index(name.removeprefix("twice "))])


@pytest.mark.parametrize("steps", [0, 4])
def test_after_learning_is_the_loss_after_learn(steps: int, phi: Params, tasks: Tasks) -> None:
    lifted = after_learning(NOISY_LOSS, sgd, steps=steps, order=2)
    drawn = lifted.draw(tasks, Generator().manual_seed(1), 1.0)
    assert drawn.names == NAMES
    rng = Generator().manual_seed(1)
    final = learn(expand_tasks({"x": phi["theta.x"]}, 5, 0), sgd(rate(0.1)), tasks, NOISY_LOSS, steps=steps, rng=rng)
    last = NOISY_LOSS.draw(tasks, rng, 1.0).batch  # other samples than any step has seen
    torch.testing.assert_close(lifted.value(phi, drawn.batch, {}), parabola_loss(final, last, {}))


def test_inner_steps_draw_by_the_share_of_inner_steps(tasks: Tasks, rng: Generator) -> None:
    """The outer loss draws from all of the data, at every outer step."""
    shares: list[float] = []

    def draw(tasks: Tasks, rng: Generator, done: float) -> DrawnBatch:
        shares.append(done)
        return EXACT_LOSS.draw(tasks, rng, done)

    lifted = after_learning(replace(EXACT_LOSS, draw=draw), sgd, steps=4, order=1)
    lifted.draw(tasks, rng, 0.3)
    assert shares == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_meta_is_learn_over_tasks_after_learning(phi: Params, tasks: Tasks, rng: Generator) -> None:
    """Alg. 3: on parabolas of one curvature the best start is the mean and the best rate the curvature's inverse."""
    lifted = over_tasks(after_learning(EXACT_LOSS, sgd, steps=3, order=2), count=5)
    start = float(lifted.value(phi, lifted.draw(tasks, rng, 1.0).batch, {}).mean())
    trained = learn(phi, fixed_adam(Adam(0.1, final_rate_share=0.0), phi, 200), tasks, lifted, steps=200, rng=rng)
    assert float(lifted.value(trained, lifted.draw(tasks, rng, 1.0).batch, {}).mean()) < 1e-6 * start
    torch.testing.assert_close(float(trained["alpha.rate"]), 1.0, rtol=0, atol=0.1)


def test_after_encoding_is_the_loss_of_predicted_parameters(tasks: Tasks, rng: Generator) -> None:
    def encoder_input(tasks: Tasks, rng: Generator) -> Batch:
        return {"seen": tasks.data["c"][tasks.rows]}

    def encode(encoder: Params, observed: Any) -> Params:
        return {"x": observed["seen"] @ encoder["w"]}

    loss = over_tasks(after_encoding(EXACT_LOSS, EncoderPrediction(encoder_input, encode)), count=5)
    phi = MetaParameters(encoder={"w": torch.zeros(3, 3).double()}).flatten()
    trained = learn(phi, fixed_adam(Adam(0.05, final_rate_share=0.0), phi, 300), tasks, loss, steps=300, rng=rng)
    torch.testing.assert_close(trained["encoder.w"], torch.eye(3).double(), rtol=0, atol=1e-3)


def test_flat_and_unflat_are_inverse() -> None:
    start = MetaParameters({"w.x": torch.ones(2)}, {"beta": torch.ones(3)}, {"in.w": torch.ones(4)})
    assert list(start.flatten()) == ["theta.w.x", "alpha.beta", "encoder.in.w"]
    for phi in (start, MetaParameters()):
        assert MetaParameters.unflatten(phi.flatten()) == phi


def test_stacked_tasks_keep_what_they_show_and_their_kinds() -> None:
    """A task without a group is a group of its own; of two kinds, each task of the rarer one counts more."""
    data = {"angles": torch.rand(8, 3), "reflectance": torch.rand(8, 3)}
    stacked = stack_tasks(Plain(), [Task("a", data, "wood"), Task("b", data, "wood"), Task("c", data)])
    assert (stacked.names, stacked.groups) == (("a", "b", "c"), ("wood", "wood", "c"))
    assert stacked.kind_weights().tolist() == [1, 1, 1]
    kinds = [torch.tensor([kind], dtype=torch.uint8) for kind in (0, 3, 0, 0)]
    stacked = stack_tasks(Plain(), [Task(str(i), data | {"kind": kind}) for i, kind in enumerate(kinds)])
    assert stacked.kind_weights().tolist() == pytest.approx([1 / 3, 1, 1 / 3, 1 / 3])
    assert stacked.select([0, 2]).kind_weights().tolist() == [0.5, 0.5]


# Clipping


def pulled(slope_theta: Tensor, slope_alpha: Tensor, limit: float) -> Tensor:
    """Clipped gradients, for each task, of a function that is linear in theta [T, 4] and alpha [K, T, 2]; [T, ...]."""
    theta = {"x": torch.zeros_like(slope_theta, requires_grad=True)}
    alpha = {"rate": torch.zeros_like(slope_alpha, requires_grad=True)}
    same_theta, same_alpha = clip_task_gradients(theta, alpha, limit)
    assert torch.equal(same_theta["x"], theta["x"])
    assert torch.equal(same_alpha["rate"], alpha["rate"])
    total = (same_theta["x"] * slope_theta).sum() + (same_alpha["rate"] * slope_alpha).sum()
    return by_task(*torch.autograd.grad(total, [theta["x"], alpha["rate"]]))


def slopes(rng: Generator) -> tuple[Tensor, Tensor]:
    """Slopes of 4 tasks whose norms range from 1e-3 to 1e6."""
    scale = torch.tensor([1e-3, 0.1, 3.0, 1e6], dtype=torch.float64)
    theta = torch.randn(4, 4, generator=rng, dtype=torch.float64) * scale[:, None]
    return theta, torch.randn(3, 4, 2, generator=rng, dtype=torch.float64) * scale[:, None]


def by_task(theta: Tensor, alpha: Tensor) -> Tensor:
    return torch.cat([theta, alpha.movedim(1, 0).flatten(1)], 1)


@pytest.mark.parametrize("limit", [0.5, math.inf])
def test_clipping_keeps_directions(limit: float, rng: Generator) -> None:
    """Gradients within the limit are unchanged to the last digit, and zeros stay zeros."""
    before = slopes(rng)
    raw, clipped = by_task(*before), pulled(*before, limit)
    norms = raw.norm(dim=1)
    assert norms[0] < 0.5 < norms[2]
    torch.testing.assert_close(clipped.norm(dim=1), norms.clamp_max(limit))
    torch.testing.assert_close(torch.cosine_similarity(raw, clipped), torch.ones(4).double())
    assert torch.equal(clipped[norms <= limit], raw[norms <= limit])
    assert not pulled(torch.zeros(4, 4), torch.zeros(3, 4, 2), limit).any()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e200])
@pytest.mark.parametrize("limit", [0.5, math.inf])
def test_a_task_that_overflows_adds_nothing(bad: float, limit: float, rng: Generator) -> None:
    before = slopes(rng)
    expected = pulled(*before, limit)
    before[1][0, 1, 0] = bad
    clipped = pulled(*before, limit)
    assert not clipped[1].any()
    assert torch.equal(clipped[[0, 2, 3]], expected[[0, 2, 3]])


def test_meta_gradient_is_the_mean_of_clipped_ones(tasks: Tasks, rng: Generator) -> None:
    """Through after_learning and over_tasks: each task's gradient, over start and rate together, within the limit."""
    phi = MetaParameters({"x": torch.zeros(3).double()}, {"rate.x": torch.full((1, 3), 0.1).double()}).flatten()

    def gradient(subset: Tasks, clip: float) -> Tensor:
        loss = over_tasks(after_learning(EXACT_LOSS, sgd, steps=2, order=2, clip=clip), count=5)
        leaves = {key: value.clone().requires_grad_() for key, value in phi.items()}
        grads, _ = loss.gradient(leaves, loss.draw(subset, rng, 1.0).batch, {}, graph=False)
        return torch.cat([grad.flatten() for grad in grads.values()])

    # the mean over tasks stands before the clip on the way back: a limit on a task's share of the mean
    limit = 0.2
    alone = torch.stack([gradient(tasks.select([i]), math.inf) for i in range(5)])
    torch.testing.assert_close(gradient(tasks, math.inf), alone.mean(0))
    clipped = alone * (limit / alone.norm(dim=1, keepdim=True)).clamp_max(1)
    torch.testing.assert_close(gradient(tasks, limit), clipped.mean(0))


# What a task's tensors must be


HOLDS = {
    "image": TensorSpec((3, "h", "w"), "uint8"),
    "map": TensorSpec(("h", "w"), low=0.0, high=1.0),
    "more": TensorSpec(("n",), optional=True),
}


def valid_tensors() -> dict[str, Tensor]:
    """Tensors as they must be, at the ends of their range."""
    return {"image": torch.zeros(3, 4, 5, dtype=torch.uint8), "map": torch.tensor([0.0, 1.0]).repeat(10).reshape(4, 5)}


@pytest.mark.parametrize(
    "further",
    [
        {},
        {"more": torch.tensor([-1e30])},
        {"map": torch.ones(4, 5, dtype=torch.float16)},
        {"map": torch.zeros(4, 5, dtype=torch.float64)},
        {"unknown": torch.ones(2, dtype=torch.int64)},
    ],
)
def test_valid_tasks_have_no_problems(further: dict[str, Tensor]) -> None:
    assert problems_of(Task("a", valid_tensors() | further), HOLDS) == []


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"image": None}, "tensor 'image' is missing"),
        ({"map": torch.ones(4, 6)}, "'map' is float32 [4, 6], expected float [h, w]"),  # h and w are the image's
        ({"map": torch.ones(4)}, "'map' is float32 [4], expected float [h, w]"),
        ({"image": torch.zeros(4, 4, 5, dtype=torch.uint8)}, "'image' is uint8 [4, 4, 5], expected uint8 [3, h, w]"),
        ({"image": torch.zeros(3, 4, 5)}, "'image' is float32 [3, 4, 5], expected uint8 [3, h, w]"),
        ({"more": torch.zeros(0)}, "'more' is float32 [0], expected float [n]"),
        ({"unknown": torch.zeros(2, dtype=torch.bfloat16)}, "'unknown' is bfloat16 [2], expected floats of 16"),
        ({"unknown": torch.tensor([0.0, math.nan])}, "'unknown' holds NaN or infinite values"),
        ({"kind": torch.tensor([0.0])}, "'kind' is float32 [1], expected uint8 [1]"),
        ({"map": torch.full((4, 5), 1.5)}, "'map' holds 1.5 to 1.5, expected 0 to 1"),
    ],
)
def test_each_problem_of_a_task_is_one_line(wrong: dict[str, Tensor | None], message: str) -> None:
    data = {key: value for key, value in (valid_tensors() | wrong).items() if value is not None}
    (problem,) = problems_of(Task("a", data), HOLDS)
    assert message in problem
    assert problem.startswith("tensor '")
