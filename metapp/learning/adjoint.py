"""One step of learning, and differentiating through many: the adjoint recursion, one step at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.utils._pytree import tree_flatten, tree_unflatten

from metapp.learning.draws import Rng
from metapp.learning.flat import FusedLoss, Packing, no_fused
from metapp.learning.task import Linear, Params


class Drawn(NamedTuple):
    """What one step sees: whose samples they are, and the samples."""

    names: tuple[str, ...]
    batch: Any


def whole(data: Any, done: float) -> Any:
    """All of the data, however far the descent is."""
    return data


class Loss(NamedTuple):
    """Alg. 2 in two halves, so that the random one stays outside of what is differentiated and compiled.

    Attributes:
        draw: (data, rng) -> Drawn; all randomness is here; rng is a generator, or one for each task (`draws`).
        value: (params, batch, learned) -> the loss of each task, [T]; `learned` are its learned parameters.
        shared: True where all tasks share the parameters (the descent follows the mean over tasks), False where
            each task has its own (it follows the sum, which moves each as if it were alone).
        linear: (params, batch, learned) -> least squares near the loss, where the network is linear in a parameter.
        stage: (data, share of the steps that were taken) -> the data that a step draws from.
        fused: theta -> the same in C for flat parameters of this layout; None where there is no such form.
    """

    draw: Callable[[Any, Any], Drawn]
    value: Callable[[Params, Any, Params], Tensor]
    shared: bool = False
    linear: Callable[[Params, Any, Params], Linear] | None = None
    stage: Callable[[Any, float], Any] = whole
    fused: Callable[[Params], FusedLoss | None] = no_fused

    def draw_at(self, data: Any, rng: Rng, step: int, steps: int) -> Drawn:
        """Draw what one of so many steps sees."""
        return self.draw(self.stage(data, step / steps), rng)

    def total(self, params: Params, batch: Any, learned: Params) -> tuple[Tensor, Tensor]:
        """The scalar to descend and the detached loss of each task, [T]."""
        each = self.value(params, batch, learned)
        return (each.mean() if self.shared else each.sum()), each.detach()


def gradient(loss: Loss, theta: Params, batch: Any, learned: Params, *, graph: bool) -> tuple[Params, Tensor]:
    """The gradient of a loss, and the detached loss of each task, [T]; `graph`: it will be differentiated itself."""
    theta = theta if graph else _leaves(theta)
    total, each = loss.total(theta, batch, learned)
    grads = torch.autograd.grad(total, list(theta.values()), create_graph=graph, materialize_grads=True)
    return dict(zip(theta, grads, strict=True)), each


class UpdateRule(NamedTuple):
    """An optimiser as pure functions and their hyperparameters.

    Attributes:
        alpha: hyperparameters by name, [K, ...]: step i uses entry min(i, K - 1), so K = 1 is the same at every step.
            Those named `loss.*` go to the loss instead of the rule.
        init: theta -> state.
        step: (alpha at this step, theta, gradient, state) -> (theta, state).
        sees: what a step gets of a batch; the gradient, or something else that stands in its place.
        packing: how steps in C read alpha; None where there are none.
    """

    alpha: Params
    init: Callable[[Params], Params]
    step: Callable[[Params, Params, Params, Params], tuple[Params, Params]]
    sees: Callable[..., tuple[Params, Tensor]] = gradient
    packing: Packing | None = None


def at_step(alpha: Params, i: int) -> Params:
    """The hyperparameters of step i."""
    return {key: value[min(i, value.shape[0] - 1)] for key, value in alpha.items()}


class StepPair(NamedTuple):
    """One step and its vector-Jacobian product.

    Attributes:
        forward: (alpha, theta, state, batch) -> (theta, state, losses, gradient).
        pullback: (alpha, theta, state, needed, pull_theta, pull_state) -> pulls of (theta, state, alpha).
        needed: (batch, gradient) -> what the pullback needs of both: the batch for order 2, which differentiates the
            gradient; for order 1 the gradient, which is a constant.
    """

    forward: Callable[..., tuple[Params, Params, Tensor, Any]]
    pullback: Callable[..., tuple[Params, Params, Params]]
    needed: Callable[[Any, Any], Any]


def step_pair(rule: UpdateRule, loss: Loss, order: int, compiled: bool) -> StepPair:
    """One step and its vector-Jacobian product; the only two functions that are worth compiling."""
    return (_compiled_pair if compiled else _eager_pair)(rule.step, rule.sees, loss, order)


@lru_cache(maxsize=32)  # compiling takes seconds
def _compiled_pair(rule_step: Callable[..., Any], rule_sees: Callable[..., Any], loss: Loss, order: int) -> StepPair:
    eager = _eager_pair(rule_step, rule_sees, loss, order)
    return eager._replace(forward=_Compiled(eager.forward), pullback=_Compiled(eager.pullback))


def _eager_pair(rule_step: Callable[..., Any], rule_sees: Callable[..., Any], loss: Loss, order: int) -> StepPair:
    def seen(alpha: Params, theta: Params, batch: Any, *, graph: bool) -> tuple[Params, Tensor]:
        learned = {key[5:]: value for key, value in alpha.items() if key.startswith("loss.")}
        result: tuple[Params, Tensor] = rule_sees(loss, theta, batch, learned, graph=graph)
        return result

    def forward(alpha: Params, theta: Params, state: Params, batch: Any) -> tuple[Params, Params, Tensor, Params]:
        grads, each = seen(alpha, theta, batch, graph=False)
        with torch.no_grad():
            moved, state = rule_step(alpha, theta, grads, state)
        return moved, state, each, grads

    def pullback(
        alpha: Params, theta: Params, state: Params, needed: Any, pull_theta: Params, pull_state: Params
    ) -> tuple[Params, Params, Params]:
        alpha, theta, state = _leaves(alpha), _leaves(theta), _leaves(state)
        grads = seen(alpha, theta, needed, graph=True)[0] if order == 2 else needed
        moved, stated = rule_step(alpha, theta, grads, state)
        outputs = [*moved.values(), *(stated[key] for key in state)]
        pulls = [*(pull_theta[key] for key in moved), *(pull_state[key] for key in state)]
        inputs = [*theta.values(), *state.values(), *alpha.values()]
        live = [pair for pair in zip(outputs, pulls, strict=True) if pair[0].requires_grad]
        grads = iter(torch.autograd.grad([o for o, _ in live], inputs, [p for _, p in live], materialize_grads=True))
        return dict(zip(theta, grads)), dict(zip(state, grads)), dict(zip(alpha, grads))  # noqa: B905

    needed = (lambda batch, grads: batch) if order == 2 else (lambda batch, grads: grads)
    return StepPair(_enable_grad(forward), _enable_grad(pullback), needed)


def _leaves(params: Params) -> Params:
    return {key: value.detach().requires_grad_() for key, value in params.items()}


def _enable_grad(function: Callable[..., Any]) -> Callable[..., Any]:
    def enabled(*args: Any) -> Any:
        with torch.enable_grad():
            return function(*args)

    return enabled


def _in_slices(pullback: Callable[..., Any], size: int) -> Callable[..., Any]:
    """The same for some tasks at a time, which lowers its memory: tasks do not see each other.

    Tensors without axes, as Adam's products of betas at first, belong to all tasks: their pulls add up.
    """

    def part(trees: tuple[Params, ...], i: int) -> tuple[Params, Params, Params]:
        own = [{key: value[i : i + size] if value.ndim else value for key, value in tree.items()} for tree in trees]
        if i:  # what is pulled from all tasks' tensors must be counted once
            own[-1] = {key: value if value.ndim else torch.zeros_like(value) for key, value in own[-1].items()}
        result: tuple[Params, Params, Params] = pullback(*own)
        return result

    def sliced(*trees: Params) -> tuple[Params, ...]:
        count = next(iter(trees[1].values())).shape[0]
        parts = [part(trees, i) for i in range(0, count, size)]
        return tuple(
            {
                key: torch.cat([one[key] for one in each]) if value.ndim else sum(one[key] for one in each)
                for key, value in each[0].items()
            }
            for each in zip(*parts, strict=True)
        )

    return sliced


class _Compiled:
    """Trace a function of flat trees that calls autograd, for the shapes of its first call, and compile the trace."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        self.programs: dict[tuple[Any, ...], tuple[Callable[..., Any], Any]] = {}

    def __call__(self, *trees: Params) -> Any:
        # contiguous, as the trace assumes: the key here stands for all that torch would check again at every call
        leaves = [value.contiguous() for tree in trees for value in tree.values()]
        key = (*map(tuple, trees), *((leaf.shape, leaf.dtype, leaf.device) for leaf in leaves))
        if key not in self.programs:
            self.programs[key] = self._compile([list(tree) for tree in trees], leaves)
        program, spec = self.programs[key]
        with torch.no_grad():
            return tree_unflatten(list(program(*leaves)), spec)

    def _compile(self, names: list[list[str]], leaves: list[Tensor]) -> tuple[Callable[..., Any], Any]:
        from torch.fx.experimental.proxy_tensor import make_fx

        spec: Any = None

        def flat(*leaves: Tensor) -> list[Tensor]:
            nonlocal spec
            values = iter(leaves)
            result = self.function(*({name: next(values) for name in tree} for tree in names))
            outputs, spec = tree_flatten(result)
            return outputs

        flat(*leaves)  # fills caches, whose making a trace would take for a part of every step
        table: dict[Any, Callable[..., Any]] = {torch.ops.aten.bmm.default: _narrow_bmm}
        program = make_fx(flat, decomposition_table=table)(*[leaf.detach() for leaf in leaves])
        options: Any = {"guard_filter_fn": torch.compiler.skip_all_guards_unsafe}
        return torch.compile(program, options=options), spec


def _narrow_bmm(left: Tensor, right: Tensor) -> Tensor:
    """A product that is a long sum for few results, as weight gradients are: on CPUs a loop beats the library's."""
    rows, inner, columns = *left.shape[1:], right.shape[2]
    if left.device.type != "cpu" or inner < 8 * max(rows, columns):
        result: Tensor = NotImplemented
        return result
    return (left[:, :, None, :] * right.mT[:, None, :, :]).sum(-1)


class _LearnThrough(torch.autograd.Function):
    """K steps of learning as one node of the graph: keeps the K states, backpropagates one recomputed at a time."""

    @staticmethod
    def forward(
        ctx: Any,
        steps: StepPair,
        rule: UpdateRule,
        batches: Sequence[Any],
        keys: Sequence[str],
        *leaves: Any,
    ) -> tuple[Tensor, ...]:
        detached = [leaf.detach() for leaf in leaves]
        theta = dict(zip(keys, detached, strict=False))
        ctx.alpha = dict(zip(rule.alpha, detached[len(keys) :], strict=True))
        state = rule.init(theta)
        ctx.steps, ctx.taken = steps, []
        for i, batch in enumerate(batches):
            before = (theta, state)
            theta, state, _, gradient = steps.forward(at_step(ctx.alpha, i), theta, state, batch)
            ctx.taken.append((*before, steps.needed(batch, gradient)))
        ctx.last_state = state
        return tuple(theta[key] for key in keys)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *pulls: Tensor) -> tuple[Any, ...]:
        pull_theta = dict(zip(ctx.taken[0][0], (pull.contiguous() for pull in pulls), strict=True))
        pull_state = {key: torch.zeros_like(value) for key, value in ctx.last_state.items()}
        pull_alpha = {key: torch.zeros_like(value) for key, value in ctx.alpha.items()}
        for i in reversed(range(len(ctx.taken))):
            pull_theta, pull_state, pulled = ctx.steps.pullback(
                at_step(ctx.alpha, i), *ctx.taken.pop(), pull_theta, pull_state
            )
            for key, value in pulled.items():
                pull_alpha[key][min(i, pull_alpha[key].shape[0] - 1)].add_(value)
        return None, None, None, None, *pull_theta.values(), *pull_alpha.values()


def learn_through(
    theta: Params,
    rule: UpdateRule,
    batches: Sequence[Any],
    loss: Loss,
    *,
    order: int,
    compiled: bool = False,
    tasks_at_once: int | None = None,
    steps: StepPair | None = None,
) -> Params:
    """Learn on given batches, differentiably in the start and in the rule's alpha.

    The gradient is the adjoint recursion over the steps: memory is one step's graph and K copies of the parameters
    and of the rule's state. Order 1 treats each step's gradient as a constant (FOMAML); order 2 is exact (MAML).
    `steps` are what takes the steps where that is not `step_pair`.
    """
    steps = steps or step_pair(rule, loss, order, compiled)
    if tasks_at_once:
        steps = steps._replace(pullback=_in_slices(steps.pullback, tasks_at_once))
    keys = list(theta)
    apply: Callable[..., Any] = _LearnThrough.apply
    final = apply(steps, rule, batches, keys, *theta.values(), *rule.alpha.values())
    return dict(zip(keys, final, strict=True))
