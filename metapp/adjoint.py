"""One step of learning, and differentiating through many: the adjoint recursion, walked back one step at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor
from torch.autograd.function import once_differentiable

from metapp.task import Params


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


def at_step(alpha: Params, i: int) -> Params:
    """The quantities of step i."""
    return {key: value[min(i, value.shape[0] - 1)] for key, value in alpha.items()}


class StepPair(NamedTuple):
    """One step, (alpha, theta, state, batch) -> (theta, state, losses), and its vector-Jacobian product."""

    forward: Callable[..., tuple[Params, Params, Tensor]]
    pullback: Callable[..., tuple[Params, Params, Params]]


@lru_cache(maxsize=64)
def step_pair(rule_step: Callable, loss: Loss, order: int, compiled: bool) -> StepPair:
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
        grads = iter(torch.autograd.grad([o for o, _ in live], inputs, [p for _, p in live], materialize_grads=True))
        return dict(zip(theta, grads)), dict(zip(state, grads)), dict(zip(alpha, grads))  # noqa: B905

    if compiled:
        return StepPair(_Compiled(forward), _Compiled(pullback))
    return StepPair(_enable_grad(forward), _enable_grad(pullback))


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
    def forward(ctx: Any, steps: StepPair, rule: UpdateRule, batches: Sequence[Any], keys: Sequence[str], *leaves: Any):
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
    steps = step_pair(rule.step, loss, order, compiled)
    keys = list(theta)
    final = _LearnThrough.apply(steps, rule, batches, keys, *theta.values(), *rule.alpha.values())
    return dict(zip(keys, final, strict=True))
