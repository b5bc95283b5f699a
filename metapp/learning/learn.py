"""learn: the one descent behind every paradigm, and the combinators that make Meta out of General.

The paper's three algorithms map to three names here: `learn` (alg. 1), a `Loss` (alg. 2), and
`over_tasks(after_learning(loss))` (alg. 3). Update rules are in `rules`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor

from metapp.learning.adjoint import Drawn, Loss, UpdateRule, at_step, learn_through, step_pair, whole
from metapp.learning.app import App, FusedApp, LinearLayer, OuterLoss, OuterSample, Staged
from metapp.learning.draws import Rng, drawn
from metapp.learning.flat import FusedLoss, no_fused
from metapp.learning.fused import flat_value, fuse
from metapp.learning.task import Params, Tasks


class MetaParameters(NamedTuple):
    """What a paradigm prepares: phi, an initialisation and a rule's hyperparameters; for General an encoder."""

    theta: Params = {}  # noqa: RUF012  (never written to)
    alpha: Params = {}  # noqa: RUF012
    encoder: Params = {}  # noqa: RUF012

    def flat(self) -> Params:
        """phi as one flat tree, with the part's name before each parameter's."""
        return {f"{part}.{key}": value for part in self._fields for key, value in getattr(self, part).items()}

    @classmethod
    def unflat(cls, phi: Params) -> MetaParameters:
        """The inverse of `flat`."""
        parts: dict[str, Params] = {part: {} for part in cls._fields}
        for name, value in phi.items():
            part, key = name.split(".", 1)
            parts[part][key] = value
        return cls(**parts)


Watch = Callable[[int, Params, Tensor], None]


class Progress(NamedTuple):
    """Where a descent is, before a step: with the state of its generator, all that the rest depends on.

    Attributes:
        step: the steps that were taken.
        theta: the parameters.
        state: the rule's own.
    """

    step: int
    theta: Params
    state: Params


def learn(
    params: Params,
    rule: UpdateRule,
    data: Any,
    loss: Loss,
    *,
    steps: int,
    rng: Rng,
    watch: Watch | None = None,
    check_every: int = 50,
    compiled: bool = False,
    since: Progress | None = None,
    keep: Callable[[Progress], object] | None = None,
    enough: Callable[[int], bool] | None = None,
) -> Params:
    """Descend a loss from a start by a rule (alg. 1).

    Args:
        params: the start; tensors [T, ...] where each task has its own.
        rule: the update rule.
        data: whatever the loss draws from.
        loss: what to descend.
        steps: number of steps.
        rng: source of all random draws; one for all tasks, or one for each.
        watch: called as watch(step, params, loss of each task) before each step's update.
        check_every: steps between two checks that the loss is finite; the first and the last are checked, too. 0: the
            first alone.
        compiled: compile the step with torch.compile (worth it from some thousand steps on).
        since: where an earlier descent was cut off, to go on from; `rng` must be in its state of then.
        keep: called with where the descent is, before anything is drawn for the next step.
        enough: asked before each step whether to leave it and the rest out.

    Returns:
        The final parameters, detached.

    Raises:
        FloatingPointError: a loss is not finite; names the tasks and the step.
    """
    theta = {key: value.detach() for key, value in params.items()}
    fused = None if since or keep else fuse(rule, loss, theta)
    if fused:
        theta, rule = {"theta": fused.layout.flat(theta)}, fused.rule(fused.gathered)
    first, theta, state = since or Progress(0, theta, rule.init(theta))
    step = (fused.steps(1) if fused else step_pair(rule, loss, 1, compiled)).forward
    for i in range(first, steps):
        if enough is not None and enough(i):
            break
        if keep is not None:
            keep(Progress(i, theta, state))
        seen = loss.draw_at(data, rng, i, steps)
        moved, state, value, _ = step(at_step(rule.alpha, i), theta, state, seen.batch)
        if i == 0 or (check_every and (i % check_every == 0 or i == steps - 1)):
            _require_finite(value, seen.names, i)
        if watch is not None:
            watch(i, fused.layout.tree(theta["theta"]) if fused else theta, value)
        theta = moved
    return fused.layout.tree(theta["theta"]) if fused else theta


def _require_finite(value: Tensor, names: tuple[str, ...], step: int) -> None:
    bad = [name for name, fine in zip(names, torch.isfinite(value).tolist(), strict=False) if not fine]
    if bad:
        raise FloatingPointError(
            f"{', '.join(bad[:3])}: the loss is not finite at step {step}; lower the learning rate or clip earlier."
        )


# Losses and the combinators that lift them


def task_loss(app: App, batch: int) -> Loss:
    """The loss of an application on samples of tasks (alg. 2), [T]."""
    return _loss_of(app, app.loss, app.sample, batch)


Draw = Callable[[Tasks, Generator, int], Any]


@functools.lru_cache(maxsize=32)  # one object for the same: compiled steps are found by it
def _loss_of(app: App, value: Callable[[Params, Any, Params], Tensor], sample: Draw, batch: int) -> Loss:
    def draw(tasks: Tasks, rng: Rng) -> Drawn:
        return Drawn(tasks.picked_names(), drawn(lambda some, own: sample(some, own, batch), tasks, rng))

    linear = app.linear if isinstance(app, LinearLayer) else None
    stage = app.stage if isinstance(app, Staged) else whole
    return Loss(draw, value, linear=linear, stage=stage, fused=_fused_of(app))


def _fused_of(app: App) -> Callable[[Params], FusedLoss | None]:
    """The application's loss in C; none where a subclass or the object itself has another loss than that is of."""
    if not isinstance(app, FusedApp):
        return no_fused
    of = {name: next(i for i, each in enumerate(type(app).__mro__) if name in vars(each)) for name in ("loss", "fused")}
    return no_fused if of["loss"] < of["fused"] else app.fused


def task_outer_loss(app: App, batch: int) -> Loss:
    """The outer loss of an application, on samples of training tasks, [T]."""
    sample = app.outer_sample if isinstance(app, OuterSample) else app.sample
    if not isinstance(app, OuterLoss):
        return _loss_of(app, app.loss, sample, batch)
    return _loss_of(app, app.outer_loss, sample, batch)._replace(fused=no_fused)


Augment = Callable[[Tasks, Generator], Tasks]


def over_tasks(loss: Loss, *, count: int, augment: Augment | None = None) -> Loss:
    """Lift a loss on given tasks to the mean over `count` random ones of a set, drawn without replacement.

    `augment` is applied to the drawn tasks before anything is sampled from them.
    """

    def draw(tasks: Tasks, rng: Generator) -> Drawn:
        picked = tasks.select(torch.randperm(len(tasks), generator=rng, device=rng.device)[:count])
        return loss.draw(augment(picked, rng) if augment else picked, rng)

    return Loss(draw, loss.value, shared=True, stage=loss.stage)


def after_learning(
    loss: Loss,
    rule: Callable[[Params], UpdateRule],
    *,
    steps: int,
    order: int,
    clip: float = float("inf"),
    compiled: bool | Callable[[], bool] = False,
    tasks_at_once: int | None = None,
    condition: Callable[[Any, Generator], Any] | None = None,
    encode: Callable[[Params, Any], Params] | None = None,
    outer_loss: Loss | None = None,
) -> Loss:
    """Lift a loss on theta to a loss on phi: what is left after learning from phi's start by phi's rule (alg. 3).

    Args:
        loss: the loss that the inner steps descend.
        rule: alpha -> update rule.
        steps: inner steps.
        order: derivative carried through the steps: 1 leaves out second derivatives (FOMAML), 2 is exact (MAML).
        clip: each task's gradient, over all of phi, is scaled down to this norm.
        compiled: compile the inner step and its adjoint; or what says so when it is asked for the first time.
        tasks_at_once: backpropagate for so many tasks at a time, which lowers the memory; None for all.
        condition, encode: where phi holds an encoder: what it reads of each task, and the task's start from that.
        outer_loss: the loss of the final theta, where that is not `loss` itself.

    Returns:
        A loss on the flat tree of MetaParameters.
    """
    last_loss = outer_loss or loss

    def draw(tasks: Any, rng: Generator) -> Drawn:
        inner = [loss.draw_at(tasks, rng, i, steps).batch for i in range(steps)]
        last = last_loss.draw(tasks, rng)
        return Drawn(last.names, (inner, last.batch, condition(tasks, rng) if condition else None))

    def value(phi: Params, batch: Any, _: Params) -> Tensor:
        inner, last, conditions = batch
        count = next(iter(last.values())).shape[0]
        start = MetaParameters.unflat(phi)
        theta = encode(start.encoder, conditions) if encode else spread(start.theta, count, 0)
        # the mean over tasks has divided each one's gradient by their number
        limit = clip / count
        if fused := fuse(rule(spread(start.alpha, 1, 1)), loss, theta):
            gathered = {key: each.expand(-1, count, *each.shape[2:]) for key, each in fused.gathered.items()}
            theta, gathered = clip_per_task({"theta": fused.layout.flat(theta)}, gathered, limit)
            flat = fused.learn_through(theta["theta"], gathered, inner, loss, order)
            return flat_value(last_loss, fused.layout, flat, last)
        theta, alpha = clip_per_task(theta, spread(start.alpha, count, 1), limit)
        by_torch = compiled() if callable(compiled) else compiled
        final = learn_through(
            theta, rule(alpha), inner, loss, order=order, compiled=by_torch, tasks_at_once=tasks_at_once
        )
        return last_loss.value(final, last, {})

    return Loss(draw, value)


def after_encoding(loss: Loss, condition: Callable[[Any, Generator], Any], encode: Callable[..., Params]) -> Loss:
    """Lift a loss on theta to a loss on an encoder, in the flat tree of MetaParameters: General's loss."""

    def draw(tasks: Any, rng: Generator) -> Drawn:
        seen = loss.draw(tasks, rng)
        return Drawn(seen.names, (condition(tasks, rng), seen.batch))

    def value(prepared: Params, batch: Any, learned: Params) -> Tensor:
        return loss.value(encode(MetaParameters.unflat(prepared).encoder, batch[0]), batch[1], learned)

    return Loss(draw, value, shared=True, stage=loss.stage)


def spread(params: Params, count: int, axis: int) -> Params:
    """The same parameters for each of `count` tasks, along a new task axis; nothing is copied."""
    return {
        key: value.unsqueeze(axis).expand(*value.shape[:axis], count, *value.shape[axis:])
        for key, value in params.items()
    }


class _ClipPerTask(torch.autograd.Function):
    """Identity whose gradient is scaled down, task by task, to a norm; meta-gradients are heavy-tailed."""

    @staticmethod
    def forward(ctx: Any, limit: float, axes: tuple[int, ...], *tensors: Tensor) -> tuple[Tensor, ...]:
        ctx.limit, ctx.axes = limit, axes
        return tuple(tensor.view_as(tensor) for tensor in tensors)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Any, ...]:
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


def clip_per_task(theta: Params, alpha: Params, limit: float) -> tuple[Params, Params]:
    """The same values; on the way back each task's gradient over both trees has at most the norm `limit`."""
    keys = [*theta, *alpha]
    axes = (0,) * len(theta) + (1,) * len(alpha)
    apply: Callable[..., Any] = _ClipPerTask.apply
    clipped = dict(zip(keys, apply(limit, axes, *theta.values(), *alpha.values()), strict=True))
    return {key: clipped[key] for key in theta}, {key: clipped[key] for key in alpha}
