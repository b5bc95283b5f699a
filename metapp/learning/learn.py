"""learn: the one descent behind every paradigm, and the combinators that make Meta out of General.

The paper's three algorithms map to three names here: `learn` (alg. 1), a `Loss` (alg. 2), and
`over_tasks(after_learning(loss))` (alg. 3). Update rules are in `rules`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple, TypeVar

import torch
from torch import Generator, Tensor

from metapp.learning.adjoint import (
    AnyBatch,
    AnyData,
    DrawnBatch,
    Loss,
    StepsOf,
    UpdateRule,
    at_step,
    learn_differentiably,
    torch_steps,
)
from metapp.learning.app import App
from metapp.learning.random_tensors import Rng, draw_per_task
from metapp.learning.task import KIND_TENSOR, Params, Tasks


class MetaParameters(NamedTuple):
    """phi: an initialisation theta_0, or the encoder that predicts it, and the rule's hyperparameters alpha."""

    theta: Params = {}  # noqa: RUF012  (never written to)
    alpha: Params = {}  # noqa: RUF012
    encoder: Params = {}  # noqa: RUF012

    def flatten(self) -> Params:
        """phi as one flat tree, with the part's name before each parameter's.

        >>> sorted(MetaParameters({"weight": torch.zeros(2)}, {"rate": torch.ones(1)}).flatten())
        ['alpha.rate', 'theta.weight']
        """
        return {f"{part}.{key}": value for part in self._fields for key, value in getattr(self, part).items()}

    @classmethod
    def unflatten(cls, phi: Params) -> MetaParameters:
        """The inverse of `flatten`.

        >>> MetaParameters.unflatten({"theta.weight": torch.zeros(2)}).theta
        {'weight': tensor([0., 0.])}
        """
        parts: dict[str, Params] = {part: {} for part in cls._fields}
        for name, value in phi.items():
            part, key = name.split(".", 1)
            parts[part][key] = value
        return cls(**parts)


class DescentState(NamedTuple):
    """The state of a descent between two steps: with the state of its generator, all that the rest depends on.

    Attributes:
        step: steps that were taken.
        theta: the parameters, detached.
        state: the rule's own, as the steps have it.
        loss: of each task before the last step, [T], detached; None before the first.
        names: of the tasks that the last step saw.
        guarded: bool [T], True for tasks whose fit is not the rule's but the guard's (`guard`); None without a guard.
    """

    step: int
    theta: Params
    state: Params
    loss: Tensor | None = None
    names: tuple[str, ...] = ()
    guarded: Tensor | None = None


def descend(
    params: Params,
    rule: UpdateRule,
    data: AnyData,
    loss: Loss,
    *,
    steps: int,
    rng: Rng,
    since: DescentState | None = None,
    steps_of: StepsOf = torch_steps,
) -> Iterator[DescentState]:
    """Descend a loss from an initialisation by a rule (alg. 1), one step at a time.

    Args:
        params: the initialisation; tensors [T, ...] if each task has its own.
        rule: the update rule.
        data: whatever the loss draws from.
        loss: to descend.
        steps: number of steps.
        rng: source of all random draws; one for all tasks, or one for each.
        since: the state of an earlier descent by the same steps, to go on from; `rng` must be in its state of then.
        steps_of: maker of the steps.

    Yields:
        The state before the first step, and after each; nothing is drawn for a step before it is asked for.

    >>> from metapp.learning.rules import sgd
    >>> loss = Loss(lambda data, rng, done: Draw((), {}), lambda theta, batch, learned: theta["x"].square())
    >>> rule = sgd({"rate": torch.tensor([0.25])})
    >>> steps = descend({"x": torch.ones(1)}, rule, None, loss, steps=2, rng=Generator())
    >>> [float(step.theta["x"]) for step in steps]
    [1.0, 0.5, 0.25]
    """
    theta = {key: value.detach() for key, value in params.items()}
    functions = steps_of(rule, loss, theta, 1)
    now = since or DescentState(0, theta, functions.init(theta))
    yield now
    for i in range(now.step, steps):
        names, batch = loss.draw(data, rng, i / steps)
        theta, state, losses, _ = functions.step(at_step(functions.alpha, i), now.theta, now.state, batch)
        now = DescentState(i + 1, theta, state, losses, names)
        yield now


def check_finite_losses(descent: Iterator[DescentState], every: int = 50) -> Iterator[DescentState]:
    """The same descent; the losses of some steps, of the first and of the last must be finite.

    Args:
        descent: as `descend` yields it.
        every: steps between two checks; 0: the first alone.

    Raises:
        FloatingPointError: a loss is not finite; names the tasks and the step.

    >>> list(check_finite(iter([DescentState(1, {}, {}, torch.tensor([float("nan")]), ("gold",))])))
    Traceback (most recent call last):
    FloatingPointError: gold: the loss is not finite at step 0; lower the learning rate or clip earlier.
    """
    unchecked = None
    for now in descent:
        if now.loss is not None:
            index = now.step - 1
            unchecked = now if every and index % every else None
            if index == 0 or (every and unchecked is None):
                _require_finite(now)
        yield now
    if unchecked is not None:
        _require_finite(unchecked)


def _require_finite(now: DescentState) -> None:
    assert now.loss is not None
    bad = [name for name, fine in zip(now.names, torch.isfinite(now.loss).tolist(), strict=False) if not fine]
    if bad:
        raise FloatingPointError(
            f"{', '.join(bad[:3])}: the loss is not finite at step {now.step - 1}; lower the learning rate or clip "
            "earlier."
        )


Item = TypeVar("Item")


def final_item(items: Iterable[Item]) -> Item:
    """The last of at least one.

    >>> final_item(iter("abc"))
    'c'
    """
    for item in items:  # noqa: B007
        pass
    return item


def learn(
    params: Params,
    rule: UpdateRule,
    data: AnyData,
    loss: Loss,
    *,
    steps: int,
    rng: Rng,
    steps_of: StepsOf = torch_steps,
) -> Params:
    """The parameters at the end of a descent (`descend`), detached.

    Raises:
        FloatingPointError: a loss is not finite; names the tasks and the step.

    >>> from metapp.learning.rules import sgd
    >>> loss = Loss(lambda data, rng, done: Draw((), {}), lambda theta, batch, learned: theta["x"].square())
    >>> learn({"x": torch.ones(1)}, sgd({"rate": torch.tensor([0.25])}), None, loss, steps=2, rng=Generator())
    {'x': tensor([0.2500])}
    """
    return final_item(
        check_finite_losses(descend(params, rule, data, loss, steps=steps, rng=rng, steps_of=steps_of))
    ).theta


# Losses and the combinators that lift them


def task_loss(app: App, batch: int, *, outer: bool = False) -> Loss:
    """The loss of an application on samples of tasks (alg. 2), [T].

    Args:
        app: the application; equal ones give one object, by which compiled steps are found.
        batch: samples of each task.
        outer: whether it is the outer loss, on samples of training tasks.
    """
    return _task_loss(replace(app), batch, outer)  # a copy, so that the cache holds no pictures of fits


@functools.lru_cache(maxsize=32)
def _task_loss(app: App, batch: int, outer: bool) -> Loss:
    sample = app.outer_sample if outer else app.sample
    # not the inherited one: steps in C know `Brdf.loss` by its name
    value = app.outer_loss if outer and type(app).outer_loss is not App.outer_loss else app.loss

    def draw(tasks: Tasks, rng: Rng, done: float) -> DrawnBatch:
        return DrawnBatch(tasks.selected_names, draw_per_task(lambda some, own: sample(some, own, batch), tasks, rng))

    return with_stages(Loss(draw, value), app.stage)


def with_stages(loss: Loss, stage: Callable[[AnyData, float], AnyData]) -> Loss:
    """The same loss of a part of the data, (data, done) -> data, that depends on how far a descent is."""
    return replace(loss, draw=lambda data, rng, done: loss.draw(stage(data, done), rng, done))


Augment = Callable[[Tasks, Generator], Tasks]


def over_tasks(loss: Loss, *, count: int, augment: Augment | None = None) -> Loss:
    """Lift a loss on given tasks to the mean over `count` random ones of a set, drawn without replacement.

    Of several kinds as many are drawn of each on average. `augment` is applied to the drawn tasks before sampling.

    >>> tasks = Tasks(("gold", "chalk", "felt"), {}, torch.arange(3))
    >>> loss = Loss(lambda tasks, rng, done: Draw(tasks.selected_names, {}), lambda theta, batch, learned: theta["x"])
    >>> over_tasks(loss, count=2).draw(tasks, Generator().manual_seed(0), 0.0).names
    ('felt', 'gold')
    """

    def draw(tasks: Tasks, rng: Generator, done: float) -> DrawnBatch:
        if KIND_TENSOR in tasks.data:
            rows = torch.multinomial(tasks.kind_weights(), min(count, len(tasks)), generator=rng)
        else:
            rows = torch.randperm(len(tasks), generator=rng, device=rng.device)[:count]
        picked = tasks.select(rows)
        return loss.draw(augment(picked, rng) if augment else picked, rng, done)

    return Loss(draw, loss.value, shared=True)


class EncoderPrediction(NamedTuple):
    """An encoder's prediction of initialisations.

    Attributes:
        condition: (tasks, rng) -> the condition that it reads of each task.
        encode: (encoder, condition) -> parameters [T, ...].
    """

    condition: Callable[[AnyData, Generator], AnyBatch]
    encode: Callable[[Params, AnyBatch], Params]


def after_learning(
    loss: Loss,
    rule: Callable[[Params], UpdateRule],
    *,
    steps: int,
    order: int,
    clip: float = float("inf"),
    encoding: EncoderPrediction | None = None,
    outer_loss: Loss | None = None,
    steps_of: StepsOf = torch_steps,
) -> Loss:
    """Lift a loss on theta to a loss on phi: the loss after learning from phi's theta by phi's rule (alg. 3).

    Args:
        loss: the loss that the inner steps descend.
        rule: alpha -> update rule.
        steps: inner steps.
        order: derivative carried through the steps: 1 leaves out second derivatives (FOMAML), 2 is exact (MAML).
        clip: each task's gradient, over all of phi, is scaled down to this norm.
        encoding: the encoder of phi, if its predictions are the initialisations.
        outer_loss: the loss of the final theta; None for `loss` itself.
        steps_of: maker of the inner steps, and of the loss of the final theta.

    Returns:
        A loss on the flat tree of MetaParameters, on all of the data however far the outer loop is.

    The loss x^2 is left at 0.25 by one step of rate 0.25 from x = 1, and its gradient in x is 2 (1 - 2 rate)^2 x:

    >>> from metapp.learning.rules import sgd
    >>> batch = {"target": torch.zeros(1)}
    >>> loss = Loss(lambda data, rng, done: Draw((), batch), lambda theta, batch, learned: theta["x"].square())
    >>> phi = MetaParameters({"x": torch.tensor(1.0)}, {"rate": torch.tensor([0.25])}).flatten()
    >>> lifted = after_learning(loss, sgd, steps=1, order=2)
    >>> drawn = lifted.draw(None, Generator(), 0.0).batch
    >>> gradient, losses = lifted.gradient(phi, drawn, {}, graph=False)
    >>> float(losses), float(gradient["theta.x"]), float(gradient["alpha.rate"])
    (0.25, 0.5, -2.0)
    """
    last_loss = outer_loss or loss

    def draw(tasks: AnyData, rng: Generator, done: float) -> DrawnBatch:
        inner = [loss.draw(tasks, rng, i / steps).batch for i in range(steps)]
        outer = last_loss.draw(tasks, rng, 1.0)
        return DrawnBatch(outer.names, (inner, outer.batch, encoding.condition(tasks, rng) if encoding else None))

    def value(phi: Params, batch: AnyBatch, _: Params) -> Tensor:
        inner, outer, condition = batch
        count = next(iter(outer.values())).shape[0]
        parts = MetaParameters.unflatten(phi)
        theta = encoding.encode(parts.encoder, condition) if encoding else expand_tasks(parts.theta, count, 0)
        # the mean over tasks has divided each one's gradient by their number
        theta, alpha = clip_task_gradients(theta, expand_tasks(parts.alpha, count, 1), clip / count)
        update_rule = rule(alpha)
        final = learn_differentiably(theta, update_rule, inner, loss, order=order, steps_of=steps_of)
        return steps_of(update_rule, last_loss, final, 1).value(final, outer)  # in C where that is to be had

    return Loss(draw, value)


def after_encoding(loss: Loss, encoding: EncoderPrediction) -> Loss:
    """Lift a loss on theta to a loss on an encoder, in the flat tree of MetaParameters: General's loss."""

    def draw(tasks: AnyData, rng: Generator, done: float) -> DrawnBatch:
        names, batch = loss.draw(tasks, rng, done)
        return DrawnBatch(names, (encoding.condition(tasks, rng), batch))

    def value(prepared: Params, batch: AnyBatch, learned: Params) -> Tensor:
        return loss.value(encoding.encode(MetaParameters.unflatten(prepared).encoder, batch[0]), batch[1], learned)

    return Loss(draw, value)


def expand_tasks(params: Params, count: int, axis: int) -> Params:
    """The same parameters for each of `count` tasks, along a new task axis; nothing is copied.

    >>> expand_tasks({"x": torch.zeros(2)}, 3, 0)["x"].shape
    torch.Size([3, 2])
    """
    return {
        key: value.unsqueeze(axis).expand(*value.shape[:axis], count, *value.shape[axis:])
        for key, value in params.items()
    }


class _ClipPerTask(torch.autograd.Function):
    """Identity whose gradient is scaled down, task by task, to a norm; meta-gradients are heavy-tailed."""

    limit: float
    axes: tuple[int, ...]

    @staticmethod
    def forward(ctx: _ClipPerTask, limit: float, axes: tuple[int, ...], *tensors: Tensor) -> tuple[Tensor, ...]:
        ctx.limit, ctx.axes = limit, axes
        return tuple(tensor.view_as(tensor) for tensor in tensors)

    @staticmethod
    def backward(ctx: _ClipPerTask, *grads: Tensor) -> tuple[Tensor | None, ...]:
        norms = []
        for grad, axis in zip(grads, ctx.axes, strict=True):
            others = [i for i in range(grad.ndim + 1) if i != axis]
            norms.append(torch.linalg.vector_norm(grad.unsqueeze(-1), dim=others))
        norm = torch.linalg.vector_norm(torch.stack(norms), dim=0)
        # a task whose gradient overflowed says nothing about the direction: it is left out of the mean
        lost = ~torch.isfinite(norm)
        scale = (ctx.limit / norm.clamp_min(1e-30)).clamp_max(1.0)
        clipped = []
        for grad, axis in zip(grads, ctx.axes, strict=True):
            shape = [1] * grad.ndim
            shape[axis] = -1
            clipped.append((grad * scale.reshape(shape)).masked_fill_(lost.reshape(shape), 0.0))
        return None, None, *clipped


def clip_task_gradients(theta: Params, alpha: Params, limit: float) -> tuple[Params, Params]:
    """The same values; on the way back each task's gradient over both trees has at most the norm `limit`.

    >>> x = torch.tensor([3.0, 0.1], requires_grad=True)
    >>> theta, _ = clip_per_task({"x": x}, {}, 1.0)
    >>> torch.autograd.grad(theta["x"].square().sum(), x)
    (tensor([1.0000, 0.2000]),)
    """
    keys = [*theta, *alpha]
    axes = (0,) * len(theta) + (1,) * len(alpha)
    apply: Callable[..., tuple[Tensor, ...]] = _ClipPerTask.apply
    clipped = dict(zip(keys, apply(limit, axes, *theta.values(), *alpha.values()), strict=True))
    return {key: clipped[key] for key in theta}, {key: clipped[key] for key in alpha}
