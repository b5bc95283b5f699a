"""The one descent behind every paradigm, and the functions that lift losses and so make Meta out of General.

The paper's three algorithms are three names here: :func:`learn` (alg. 1), :func:`task_loss` (alg. 2), and
`over_tasks(after_learning(loss))` (alg. 3). Update rules are in `metapp.learning.rules`; which loss, rule and
initialisation a paradigm has is decided in `metapp.paradigms`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.learning.adjoint import (
    AnyBatch,
    AnyData,
    DrawnBatch,
    Loss,
    StepMaker,
    UpdateRule,
    at_step,
    learn_differentiably,
    torch_steps,
)
from metapp.learning.app import App
from metapp.learning.random_tensors import Rng, draw_per_task
from metapp.learning.task import KIND_TENSOR, Params, Tasks


class MetaParameters(NamedTuple):
    """Phi, the parameters of a checkpoint: what a fit begins at, and the hyperparameters of its rule.

    Attributes:
        theta: the initialisation theta_0 of one task, without a task axis; {} if an encoder predicts it.
        alpha: the rule's hyperparameters, [K, ...].
        encoder: the parameters of the encoder that predicts initialisations; {} if there is none.
    """

    theta: Params = {}  # noqa: RUF012  (never written to)
    alpha: Params = {}  # noqa: RUF012
    encoder: Params = {}  # noqa: RUF012

    def flatten(self) -> Params:
        """Return phi as one flat tree, in which names begin with "theta.", "alpha." or "encoder.".

        >>> sorted(MetaParameters({"weight": torch.zeros(2)}, {"rate": torch.ones(1)}).flatten())
        ['alpha.rate', 'theta.weight']
        """
        return {f"{part}.{key}": value for part in self._fields for key, value in getattr(self, part).items()}

    @classmethod
    def unflatten(cls, phi: Params) -> MetaParameters:
        """Restore phi from a flat tree. This is the inverse of :meth:`flatten`.

        >>> MetaParameters.unflatten({"theta.weight": torch.zeros(2)}).theta
        {'weight': tensor([0., 0.])}
        """
        parts: dict[str, Params] = {part: {} for part in cls._fields}
        for name, value in phi.items():
            part, key = name.split(".", 1)
            parts[part][key] = value
        return cls(**parts)


class DescentState(NamedTuple):
    """The state of a descent between two steps.

    Together with the state of the random generator it is all that the remaining steps depend on.

    Attributes:
        step: the number of steps that were taken.
        theta: the parameters, detached.
        rule_state: the state of the update rule, as its steps return it.
        loss: the loss of each task before the last step, [T], detached; None before the first step.
        names: the names of the tasks that these losses are of.
        guarded: bool [T], True for tasks whose result is the guard's instead of the rule's (see
            :mod:`metapp.learning.guard`); None without a guard.
    """

    step: int
    theta: Params
    rule_state: Params
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
    make_steps: StepMaker = torch_steps,
) -> Iterator[DescentState]:
    """Descend a loss from an initialisation by a rule (alg. 1), one step at a time.

    Args:
        params: the initialisation; tensors [T, ...] if each task has parameters for itself.
        rule: the update rule.
        data: the data that the loss draws from, most often tasks.
        loss: the loss.
        steps: the number of steps.
        rng: the source of all random numbers, one for all tasks or one for each.
        since: the state of an earlier descent by the same steps, which is continued; `rng` must be in the state that it
            had then.
        make_steps: a function that makes the steps; see :func:`metapp.learning.adjoint.torch_steps`.

    Yields:
        The state before the first step, and after each step. Random numbers of a step are drawn when it is asked for.

    >>> from metapp.learning.rules import sgd
    >>> loss = Loss(lambda data, rng, done: DrawnBatch((), {}), lambda theta, batch, _: theta["x"].square())
    >>> rule = sgd({"rate": torch.tensor([0.25])})
    >>> steps = descend({"x": torch.ones(1)}, rule, None, loss, steps=2, rng=Generator())
    >>> [float(step.theta["x"]) for step in steps]
    [1.0, 0.5, 0.25]
    """
    theta = {key: value.detach() for key, value in params.items()}
    functions = make_steps(rule, loss, theta, 1)
    latest = since or DescentState(0, theta, functions.init(theta))
    yield latest
    for i in range(latest.step, steps):
        names, batch = loss.draw(data, rng, i / steps)
        theta, state, losses, _ = functions.step(at_step(functions.alpha, i), latest.theta, latest.rule_state, batch)
        latest = DescentState(i + 1, theta, state, losses, names)
        yield latest


def check_finite_losses(descent: Iterator[DescentState], every: int = 50) -> Iterator[DescentState]:
    """Pass on the states of a descent, and require that losses are finite.

    Reading losses waits for a GPU: besides the first and the last step, only every so many are checked.

    Args:
        descent: the states of a descent, from :func:`descend`.
        every: the number of steps between two checks; 0 checks the first step alone.

    Raises:
        FloatingPointError: a loss is not finite; the message names the tasks and the step.

    >>> list(check_finite_losses(iter([DescentState(1, {}, {}, torch.tensor([float("nan")]), ("gold",))])))
    Traceback (most recent call last):
    FloatingPointError: gold: the loss is not finite at step 0; lower the learning rate or clip earlier.
    """
    unchecked = None
    for state in descent:
        if state.loss is not None:
            index = state.step - 1
            unchecked = state if every and index % every else None
            if index == 0 or (every and unchecked is None):
                _require_finite(state)
        yield state
    if unchecked is not None:
        _require_finite(unchecked)


def _require_finite(state: DescentState) -> None:
    """Raise FloatingPointError, with the names of tasks, if losses before the last step are not finite."""
    assert state.loss is not None
    bad = [name for name, finite in zip(state.names, torch.isfinite(state.loss).tolist(), strict=False) if not finite]
    if bad:
        raise FloatingPointError(
            f"{', '.join(bad[:3])}: the loss is not finite at step {state.step - 1}; lower the learning rate or clip "
            "earlier."
        )


Item = TypeVar("Item")


def final_item(items: Iterable[Item]) -> Item:
    """Exhaust an iterator of at least one item and return the last one.

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
    make_steps: StepMaker = torch_steps,
) -> Params:
    """Learn (alg. 1): descend a loss from an initialisation, and return the final parameters, detached.

    See :func:`descend` for the arguments.

    Raises:
        FloatingPointError: a loss is not finite; the message names the tasks and the step.

    >>> from metapp.learning.rules import sgd
    >>> loss = Loss(lambda data, rng, done: DrawnBatch((), {}), lambda theta, batch, _: theta["x"].square())
    >>> learn({"x": torch.ones(1)}, sgd({"rate": torch.tensor([0.25])}), None, loss, steps=2, rng=Generator())
    {'x': tensor([0.2500])}
    """
    return final_item(
        check_finite_losses(descend(params, rule, data, loss, steps=steps, rng=rng, make_steps=make_steps))
    ).theta


# Losses, and functions that lift them


def task_loss(app: App, samples: int, *, outer: bool = False) -> Loss:
    """Return the loss of an application on random samples of tasks (alg. 2), [T].

    Args:
        app: the application; equal ones give one object, by which compiled steps are found again.
        samples: the number of samples of each task.
        outer: whether to return the outer loss, on samples of training tasks, instead of the inner loss.
    """
    return _task_loss(
        replace(app), samples, outer
    )  # a copy, so that the cache keeps no pictures of fits that the application holds


@functools.lru_cache(maxsize=32)
def _task_loss(app: App, samples: int, outer: bool) -> Loss:
    """Return a loss that is made once for equal arguments. See :func:`task_loss`."""
    sample = app.outer_sample if outer else app.sample
    # faster steps of extensions recognise a loss by its method
    value = app.outer_loss if outer and app.has_outer_loss else app.loss

    def draw(tasks: Tasks, rng: Rng, done: float) -> DrawnBatch:
        batch = draw_per_task(lambda tasks, rng: sample(tasks, rng, samples), tasks, rng)
        return DrawnBatch(tasks.selected_names, batch)

    return with_coarsening(Loss(draw, value), app.coarsen)


def with_coarsening(loss: Loss, coarsen: Callable[[AnyData, float], AnyData]) -> Loss:
    """Return a loss that draws from a part of the data, which depends on the share of steps that were taken.

    Args:
        loss: the loss that draws from complete data.
        coarsen: a function (data, done) -> the part of the data to draw from; `done` is in [0, 1].
    """
    return replace(loss, draw=lambda data, rng, done: loss.draw(coarsen(data, done), rng, done))


Augment = Callable[[Tasks, Generator], Tasks]


def over_tasks(loss: Loss, *, count: int, augment: Augment | None = None) -> Loss:
    """Lift a loss on given tasks to the mean over random tasks of a set.

    The tasks are drawn without replacement. If tasks are of several kinds, on average as many of each kind are drawn.

    Args:
        loss: the loss on given tasks.
        count: the number of tasks that a step draws.
        augment: a function (tasks, rng) -> augmented tasks, applied before samples are drawn; None for no augmentation.

    >>> tasks = Tasks(("gold", "chalk", "felt"), {}, torch.arange(3))
    >>> def draw_names(tasks, rng, done):
    ...     return DrawnBatch(tasks.selected_names, {})
    >>> loss = Loss(draw_names, lambda theta, batch, _: theta["x"])
    >>> over_tasks(loss, count=2).draw(tasks, Generator().manual_seed(0), 0.0).names
    ('felt', 'gold')
    """

    def draw(tasks: Tasks, rng: Generator, done: float) -> DrawnBatch:
        if KIND_TENSOR in tasks.data:
            rows = torch.multinomial(tasks.kind_weights(), min(count, len(tasks)), generator=rng)
        else:
            rows = torch.randperm(len(tasks), generator=rng, device=rng.device)[:count]
        drawn = tasks.select(rows)
        return loss.draw(augment(drawn, rng) if augment else drawn, rng, done)

    return replace(loss, draw=draw, shared=True)


class EncoderPrediction(NamedTuple):
    """The prediction of initialisations by an encoder, as two functions.

    Attributes:
        encoder_input: a function (tasks, rng) -> the input of the encoder for each task.
        encode: a function (encoder parameters, encoder input) -> parameters [T, ...].
    """

    encoder_input: Callable[[AnyData, Generator], AnyBatch]
    encode: Callable[[Params, AnyBatch], Params]


@dataclass(frozen=True, kw_only=True)
class LossAfterLearning(Loss):
    """A loss on phi with all that it is made of, by which faster steps recognise it; see :func:`after_learning`.

    Attributes:
        inner_loss: the loss that the inner steps descend.
        rule: a function from hyperparameters alpha to an update rule.
        steps: the number of inner steps.
        order: the order of derivatives through the steps, 2 or 1.
        clip: the greatest norm of each task's gradient.
        prediction: how phi's encoder predicts initialisations; None if phi holds the initialisation itself.
        outer_loss: the loss of the final theta.
    """

    inner_loss: Loss
    rule: Callable[[Params], UpdateRule]
    steps: int
    order: int
    clip: float
    prediction: EncoderPrediction | None
    outer_loss: Loss


def after_learning(
    loss: Loss,
    rule: Callable[[Params], UpdateRule],
    *,
    steps: int,
    order: int,
    clip: float = float("inf"),
    prediction: EncoderPrediction | None = None,
    outer_loss: Loss | None = None,
    make_steps: StepMaker = torch_steps,
) -> LossAfterLearning:
    """Lift a loss on theta to a loss on phi: the loss after a fit that phi initialises (alg. 3).

    Args:
        loss: the loss that the inner steps descend.
        rule: a function from hyperparameters alpha to an update rule.
        steps: the number of inner steps.
        order: 2 carries exact derivatives through the steps (MAML), 1 leaves out second derivatives (FOMAML).
        clip: the norm to which each task's gradient, over all of phi, is scaled down if it is longer.
        prediction: how phi's encoder predicts initialisations; None if phi holds the initialisation itself.
        outer_loss: the loss of the final theta; None for `loss` itself.
        make_steps: a function that makes the inner steps, and evaluates the loss of the final theta.

    Returns:
        A loss on the flat tree of MetaParameters. It draws from all of the data at every outer step.

    The loss x^2 is left at 0.25 by one step of rate 0.25 from x = 1, and its gradient in x is 2 (1 - 2 rate)^2 x:

    >>> from metapp.learning.rules import sgd
    >>> batch = {"target": torch.zeros(1)}
    >>> loss = Loss(lambda data, rng, done: DrawnBatch((), batch), lambda theta, batch, _: theta["x"].square())
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
        encoder_input = prediction.encoder_input(tasks, rng) if prediction else None
        return DrawnBatch(outer.names, (inner, outer.batch, encoder_input))

    def value(phi: Params, batch: AnyBatch, _: Params) -> Tensor:
        inner, outer, encoder_input = batch
        count = next(iter(outer.values())).shape[0]
        parts = MetaParameters.unflatten(phi)
        theta = prediction.encode(parts.encoder, encoder_input) if prediction else expand_tasks(parts.theta, count, 0)
        # the mean over tasks divides the gradient of each task by their number, so that the limit is divided, too
        theta, alpha = clip_task_gradients(theta, expand_tasks(parts.alpha, count, 1), clip / count)
        update_rule = rule(alpha)
        final = learn_differentiably(theta, update_rule, inner, loss, order=order, make_steps=make_steps)
        return make_steps(update_rule, last_loss, final, 1).value(final, outer)  # steps may evaluate the loss in C

    return LossAfterLearning(
        draw,
        value,
        inner_loss=loss,
        rule=rule,
        steps=steps,
        order=order,
        clip=clip,
        prediction=prediction,
        outer_loss=last_loss,
    )


def after_encoding(loss: Loss, prediction: EncoderPrediction) -> Loss:
    """Lift a loss on theta to a loss on an encoder that predicts theta: the loss by which General is trained.

    Args:
        loss: the loss on theta.
        prediction: how an encoder predicts theta.

    Returns:
        A loss on the flat tree of MetaParameters that hold an encoder.
    """

    def draw(tasks: AnyData, rng: Generator, done: float) -> DrawnBatch:
        names, batch = loss.draw(tasks, rng, done)
        return DrawnBatch(names, (prediction.encoder_input(tasks, rng), batch))

    def value(phi: Params, batch: AnyBatch, loss_parameters: Params) -> Tensor:
        return loss.value(prediction.encode(MetaParameters.unflatten(phi).encoder, batch[0]), batch[1], loss_parameters)

    return Loss(draw, value)


def expand_tasks(params: Params, count: int, axis: int) -> Params:
    """Expand parameters to `count` tasks along a new task axis, without copying them.

    >>> expand_tasks({"x": torch.zeros(2)}, 3, 0)["x"].shape
    torch.Size([3, 2])
    """
    return {
        key: value.unsqueeze(axis).expand(*value.shape[:axis], count, *value.shape[axis:])
        for key, value in params.items()
    }


class _ClippedIdentity(torch.autograd.Function):
    """An identity whose gradient is scaled down, task by task, to a greatest norm; meta-gradients are heavy-tailed."""

    limit: float
    axes: tuple[int, ...]

    @staticmethod
    @override
    def forward(ctx: _ClippedIdentity, limit: float, axes: tuple[int, ...], *tensors: Tensor) -> tuple[Tensor, ...]:
        ctx.limit, ctx.axes = limit, axes
        return tuple(tensor.view_as(tensor) for tensor in tensors)

    @staticmethod
    @override
    def backward(ctx: _ClippedIdentity, *grads: Tensor) -> tuple[Tensor | None, ...]:
        norms = []
        for grad, axis in zip(grads, ctx.axes, strict=True):
            others = [i for i in range(grad.ndim + 1) if i != axis]
            norms.append(torch.linalg.vector_norm(grad.unsqueeze(-1), dim=others))
        norm = torch.linalg.vector_norm(torch.stack(norms), dim=0)
        # a task whose gradient overflowed says nothing about the direction: it is left out of the mean
        overflowed = ~torch.isfinite(norm)
        scale = (ctx.limit / norm.clamp_min(1e-30)).clamp_max(1.0)
        clipped = []
        for grad, axis in zip(grads, ctx.axes, strict=True):
            shape = [1] * grad.ndim
            shape[axis] = -1
            clipped.append((grad * scale.reshape(shape)).masked_fill_(overflowed.reshape(shape), 0.0))
        return None, None, *clipped


def clip_task_gradients(theta: Params, alpha: Params, limit: float) -> tuple[Params, Params]:
    """Return parameters unchanged, and limit the norm of each task's gradient in the backward pass.

    Args:
        theta: parameters [T, ...].
        alpha: hyperparameters [K, T, ...].
        limit: the greatest norm of one task's gradient, over both trees together.

    >>> x = torch.tensor([3.0, 0.1], requires_grad=True)
    >>> theta, _ = clip_task_gradients({"x": x}, {}, 1.0)
    >>> torch.autograd.grad(theta["x"].square().sum(), x)
    (tensor([1.0000, 0.2000]),)
    """
    keys = [*theta, *alpha]
    axes = (0,) * len(theta) + (1,) * len(alpha)
    apply: Callable[..., tuple[Tensor, ...]] = _ClippedIdentity.apply
    clipped = dict(zip(keys, apply(limit, axes, *theta.values(), *alpha.values()), strict=True))
    return {key: clipped[key] for key in theta}, {key: clipped[key] for key in alpha}
