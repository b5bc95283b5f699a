"""learn: the one descent behind every paradigm, and the combinators that make Meta out of General.

The paper's three algorithms map to three names here: `learn` (alg. 1), a `Loss` (alg. 2), and
`over_tasks(after_learning(loss))` (alg. 3). Update rules are in `rules`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor
from torch.autograd.function import once_differentiable

from metapp.task import App, Params, Tasks


class Drawn(NamedTuple):
    """What one step sees: whose samples they are, and the samples."""

    names: tuple[str, ...]
    batch: Any


class Loss(NamedTuple):
    """Alg. 2 in two halves, so that the random one stays outside of what is differentiated and compiled.

    Attributes:
        draw: (data, rng) -> Drawn; all randomness is here.
        value: (params, batch, shape) -> the loss of each task, [T].
        shared: True where all tasks share the parameters (the descent follows the mean over tasks), False where
            each task has its own (it follows the sum, which moves each as if it were alone).
    """

    draw: Callable[[Any, Generator], Drawn]
    value: Callable[[Params, Any, Params], Tensor]
    shared: bool = False

    def total(self, params: Params, batch: Any, shape: Params) -> tuple[Tensor, Tensor]:
        """The scalar to descend and the detached loss of each task, [T]."""
        each = self.value(params, batch, shape)
        return (each.mean() if self.shared else each.sum()), each.detach()


class UpdateRule(NamedTuple):
    """An optimiser as two pure functions and the quantities they use.

    Attributes:
        alpha: quantities by name, [K, ...]: step i uses entry min(i, K - 1), so K = 1 is the same at every step.
            Those named `loss.*` go to the loss instead of the rule.
        init: theta -> state.
        step: (alpha at this step, theta, gradient, state) -> (theta, state).
    """

    alpha: Params
    init: Callable[[Params], Params]
    step: Callable[[Params, Params, Params, Params], tuple[Params, Params]]


class MetaParameters(NamedTuple):
    """phi: a start and the quantities of a rule; `encoder` replaces the start where General's encoder gives it."""

    theta: Params
    alpha: Params
    encoder: Params = {}  # noqa: RUF012  (never written to)

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


def learn(
    params: Params,
    rule: UpdateRule,
    data: Any,
    loss: Loss,
    *,
    steps: int,
    rng: Generator,
    watch: Watch | None = None,
    check_every: int = 50,
    compiled: bool = False,
) -> Params:
    """Descend a loss from a start by a rule (alg. 1).

    Args:
        params: the start; tensors [T, ...] where each task has its own.
        rule: the update rule.
        data: whatever the loss draws from.
        loss: what to descend.
        steps: number of steps.
        rng: source of all random draws.
        watch: called as watch(step, params, loss of each task) before each step's update.
        check_every: steps between two checks that the loss is finite.
        compiled: compile the step with torch.compile (worth it from some thousand steps on).

    Returns:
        The final parameters, detached.

    Raises:
        FloatingPointError: a loss is not finite; names the tasks and the step.
    """
    theta = {key: value.detach() for key, value in params.items()}
    state = rule.init(theta)
    step = _steps(rule.step, loss, 1, compiled).forward
    for i in range(steps):
        drawn = loss.draw(data, rng)
        moved, state, value = step(at_step(rule.alpha, i), theta, state, drawn.batch)
        if i % check_every == 0 or i == steps - 1:
            _require_finite(value, drawn.names, i)
        if watch is not None:
            watch(i, theta, value)
        theta = moved
    return theta


def at_step(alpha: Params, i: int) -> Params:
    """The quantities of step i."""
    return {key: value[min(i, value.shape[0] - 1)] for key, value in alpha.items()}


def _require_finite(value: Tensor, names: tuple[str, ...], step: int) -> None:
    bad = [name for name, fine in zip(names, torch.isfinite(value).tolist(), strict=False) if not fine]
    if bad:
        raise FloatingPointError(
            f"{', '.join(bad[:3])}: the loss is not finite at step {step}; lower the learning rate or clip earlier."
        )


# Losses and the combinators that lift them


def task_loss(app: App, batch: int) -> Loss:
    """The loss of an application on samples of tasks (alg. 2), [T]."""

    def draw(tasks: Tasks, rng: Generator) -> Drawn:
        return Drawn(tasks.picked_names(), app.sample(tasks, rng, batch))

    return Loss(draw, app.loss)


Augment = Callable[[Tasks, Generator], Tasks]


def over_tasks(loss: Loss, *, count: int, augment: Augment | None = None) -> Loss:
    """Lift a loss on given tasks to the mean over `count` random ones of a set, drawn without replacement.

    `augment` turns the drawn tasks into made-up relatives of theirs before anything is sampled from them.
    """

    def draw(tasks: Tasks, rng: Generator) -> Drawn:
        picked = tasks.select(torch.randperm(len(tasks), generator=rng, device=rng.device)[:count])
        return loss.draw(augment(picked, rng) if augment else picked, rng)

    return Loss(draw, loss.value, shared=True)


Start = Callable[[Params, Any], Params]


def after_learning(
    loss: Loss,
    rule: Callable[[Params], UpdateRule],
    *,
    steps: int,
    order: int,
    clip: float = float("inf"),
    outer: Loss | None = None,
    observe: Callable[[Any, Generator], Any] | None = None,
    encode: Start | None = None,
    compiled: bool = False,
) -> Loss:
    """Lift a loss on theta to a loss on phi: what is left after learning from phi's start by phi's rule (alg. 3).

    Args:
        loss: the loss that the inner steps descend.
        rule: alpha -> update rule.
        steps: inner steps.
        order: derivative carried through the steps: 1 leaves out second derivatives (FOMAML), 2 is exact (MAML).
        clip: each task's gradient, over all of phi, is scaled down to this norm.
        outer: the loss that is measured after learning; the same as the inner one unless given.
        observe, encode: where phi holds an encoder: what it sees of the tasks, and (encoder, observed) -> start.
        compiled: compile the inner step and its adjoint.

    Returns:
        A loss on the flat tree of MetaParameters.
    """
    measured = outer or loss

    def draw(tasks: Any, rng: Generator) -> Drawn:
        inner = [loss.draw(tasks, rng).batch for _ in range(steps)]
        last = measured.draw(tasks, rng)
        return Drawn(last.names, (inner, last.batch, observe(tasks, rng) if observe else None))

    def value(phi: Params, batch: Any, _: Params) -> Tensor:
        inner, last, observed = batch
        count = next(iter(last.values())).shape[0]
        theta, alpha, encoder = MetaParameters.unflat(phi)
        theta = encode(encoder, observed) if encode else _spread(theta, count, 0)
        alpha = _spread(alpha, count, 1)
        theta, alpha = clip_per_task(theta, alpha, clip)
        final = learn_through(theta, rule(alpha), inner, loss, order=order, compiled=compiled)
        return measured.value(final, last, {})

    return Loss(draw, value)


def after_encoding(loss: Loss, observe: Callable[[Any, Generator], Any], encode: Start) -> Loss:
    """Lift a loss on theta to a loss on an encoder's parameters: General's loss."""

    def draw(tasks: Any, rng: Generator) -> Drawn:
        drawn = loss.draw(tasks, rng)
        return Drawn(drawn.names, (observe(tasks, rng), drawn.batch))

    def value(encoder: Params, batch: Any, shape: Params) -> Tensor:
        return loss.value(encode(encoder, batch[0]), batch[1], shape)

    return Loss(draw, value, shared=True)


def _spread(params: Params, count: int, axis: int) -> Params:
    """One copy for each task, without copying."""
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
    def backward(ctx: Any, *grads: Tensor) -> tuple[Any, ...]:  # type: ignore[override]
        flat = [grad.movedim(axis, 0).flatten(1) for grad, axis in zip(grads, ctx.axes, strict=True)]
        norm = torch.stack([grad.square().sum(1) for grad in flat]).sum(0).sqrt()
        # a task whose gradient overflowed says nothing about the direction: it is left out of the mean
        scale = torch.where(torch.isfinite(norm), (ctx.limit / norm.clamp_min(1e-30)).clamp_max(1.0), 0.0)
        clipped = []
        for grad, axis in zip(grads, ctx.axes, strict=True):
            shape = [1] * grad.ndim
            shape[axis] = -1
            clipped.append(torch.nan_to_num(grad, 0.0, 0.0, 0.0) * scale.reshape(shape))
        return None, None, *clipped


def clip_per_task(theta: Params, alpha: Params, limit: float) -> tuple[Params, Params]:
    """The same values; on the way back each task's gradient over both trees has at most the norm `limit`."""
    keys = [*theta, *alpha]
    axes = (0,) * len(theta) + (1,) * len(alpha)
    clipped = dict(zip(keys, _ClipPerTask.apply(limit, axes, *theta.values(), *alpha.values()), strict=True))
    return {key: clipped[key] for key in theta}, {key: clipped[key] for key in alpha}


# Differentiating through learning: the adjoint of one step, walked back


class _Steps(NamedTuple):
    forward: Callable[..., tuple[Params, Params, Tensor]]
    pullback: Callable[..., tuple[Params, Params, Params]]


@lru_cache(maxsize=64)
def _steps(rule_step: Callable, loss: Loss, order: int, compiled: bool) -> _Steps:
    """One step and its vector-Jacobian product; the only two functions that are worth compiling."""

    def advance(alpha: Params, theta: Params, state: Params, batch: Any, *, graph: bool) -> tuple:
        shape = {key[5:]: value for key, value in alpha.items() if key.startswith("loss.")}
        total, each = loss.total(theta, batch, shape)
        grads = torch.autograd.grad(total, list(theta.values()), create_graph=graph, materialize_grads=True)
        return *rule_step(alpha, theta, dict(zip(theta, grads, strict=True)), state), each

    def forward(alpha: Params, theta: Params, state: Params, batch: Any) -> tuple[Params, Params, Tensor]:
        theta = _leaves(theta)
        moved, state, each = advance(alpha, theta, state, batch, graph=False)
        return {key: value.detach() for key, value in moved.items()}, state, each

    def pullback(
        alpha: Params, theta: Params, state: Params, batch: Any, pull_theta: Params, pull_state: Params
    ) -> tuple[Params, Params, Params]:
        alpha, theta, state = _leaves(alpha), _leaves(theta), _leaves(state)
        moved, stated, _ = advance(alpha, theta, state, batch, graph=order == 2)
        outputs = [*moved.values(), *(stated[key] for key in state)]
        pulls = [*(pull_theta[key] for key in moved), *(pull_state[key] for key in state)]
        inputs = [*theta.values(), *state.values(), *alpha.values()]
        live = [pair for pair in zip(outputs, pulls, strict=True) if pair[0].requires_grad]
        grads = iter(
            torch.autograd.grad([o for o, _ in live], inputs, [p for _, p in live], materialize_grads=True)
        )
        return dict(zip(theta, grads)), dict(zip(state, grads)), dict(zip(alpha, grads))  # noqa: B905

    if compiled:
        return _Steps(_Compiled(forward), _Compiled(pullback))
    return _Steps(_enable_grad(forward), _enable_grad(pullback))


def _leaves(params: Params) -> Params:
    return {key: value.detach().requires_grad_() for key, value in params.items()}


def _enable_grad(function: Callable) -> Callable:
    def enabled(*args: Any) -> Any:
        with torch.enable_grad():
            return function(*args)

    return enabled


class _Compiled:
    """Trace a function that calls autograd, for the shapes of its first call, and compile the trace."""

    def __init__(self, function: Callable) -> None:
        self.function = _enable_grad(function)
        self.programs: dict[tuple, Callable] = {}

    def __call__(self, *args: Any) -> Any:
        leaves, spec = torch.utils._pytree.tree_flatten(args)
        key = (spec, *((leaf.shape, leaf.dtype, leaf.device) for leaf in leaves))
        if key not in self.programs:
            from torch.fx.experimental.proxy_tensor import make_fx

            detached = torch.utils._pytree.tree_unflatten([leaf.detach() for leaf in leaves], spec)
            self.programs[key] = torch.compile(make_fx(self.function)(*detached))
        with torch.no_grad():
            return self.programs[key](*args)


class _LearnThrough(torch.autograd.Function):
    """K steps of learning as one node of the graph: keeps the K states, walks back one recomputed step at a time."""

    @staticmethod
    def forward(ctx: Any, steps: _Steps, rule: UpdateRule, batches: Sequence[Any], keys: Sequence[str], *leaves: Any):
        detached = [leaf.detach() for leaf in leaves]
        theta = dict(zip(keys, detached, strict=False))
        ctx.alpha = dict(zip(rule.alpha, detached[len(keys) :], strict=True))
        state = rule.init(theta)
        ctx.steps, ctx.batches, ctx.states = steps, batches, []
        for i, batch in enumerate(batches):
            ctx.states.append((theta, state))
            theta, state, _ = steps.forward(at_step(ctx.alpha, i), theta, state, batch)
        ctx.last_state = state
        return tuple(theta[key] for key in keys)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *pulls: Tensor):
        pull_theta = dict(zip(ctx.states[0][0], (pull.contiguous() for pull in pulls), strict=True))
        pull_state = {key: torch.zeros_like(value) for key, value in ctx.last_state.items()}
        pull_alpha = {key: torch.zeros_like(value) for key, value in ctx.alpha.items()}
        for i in reversed(range(len(ctx.batches))):
            theta, state = ctx.states.pop()
            pull_theta, pull_state, pulled = ctx.steps.pullback(
                at_step(ctx.alpha, i), theta, state, ctx.batches[i], pull_theta, pull_state
            )
            for key, value in pulled.items():
                pull_alpha[key][min(i, pull_alpha[key].shape[0] - 1)] += value
        return None, None, None, None, *pull_theta.values(), *pull_alpha.values()


def learn_through(
    theta: Params, rule: UpdateRule, batches: Sequence[Any], loss: Loss, *, order: int, compiled: bool = False
) -> Params:
    """Learn on given batches, differentiably in the start and in the rule's alpha.

    The gradient is the adjoint recursion over the steps: memory is one step's graph and K copies of the parameters
    and of the rule's state. Order 1 treats each step's gradient as a constant (FOMAML); order 2 is exact (MAML).
    """
    steps = _steps(rule.step, loss, order, compiled)
    keys = list(theta)
    final = _LearnThrough.apply(steps, rule, batches, keys, *theta.values(), *rule.alpha.values())
    return dict(zip(keys, final, strict=True))
