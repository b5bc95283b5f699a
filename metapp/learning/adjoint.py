"""One step of learning, and differentiating through many: the adjoint recursion, one step at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from metapp.learning.task import Params
from metapp.registry import registry

AnyData = Any  # what a loss draws from: tasks, most often
AnyBatch = Any  # what it draws: tensors by name, or a tuple of such; or what is kept of these for the way back
RuleStep = Callable[[Params, Params, Params, Params], tuple[Params, Params]]
ForwardStep = Callable[[Params, Params, Params, AnyBatch], tuple[Params, Params, Tensor, AnyBatch]]
BackwardStep = Callable[[Params, Params, Params, AnyBatch, Params, Params], tuple[Params, Params, Params]]


class Drawn(NamedTuple):
    """A batch, and the names of the tasks whose samples it holds."""

    names: tuple[str, ...]
    batch: AnyBatch


@dataclass(frozen=True)
class Loss:
    """Alg. 2 in two halves, so that the random one stays outside of what is differentiated and compiled.

    Attributes:
        draw: (data, rng, done) -> Drawn; all randomness is here; rng is a generator, or one for each task (`draws`);
            done is the share of the descent's steps that were taken, in [0, 1]: at 1 all of the data is drawn from.
        value: (params, batch, learned) -> the loss of each task, [T]; `learned` are its learned parameters.
        shared: True where all tasks share the parameters (the descent follows the mean over tasks), False where
            each task has its own (it follows the sum, which moves each as if it were alone).
    """

    draw: Callable[[AnyData, Any, float], Drawn]
    value: Callable[[Params, AnyBatch, Params], Tensor]
    shared: bool = False

    def gradient(self, theta: Params, batch: AnyBatch, learned: Params, *, graph: bool) -> tuple[Params, Tensor]:
        """The gradient that a step follows, and the detached loss of each task, [T].

        Args:
            theta: parameters.
            batch: as drawn.
            learned: the loss's learned parameters.
            graph: whether the gradient will be differentiated itself.
        """
        theta = theta if graph else _leaves(theta)
        losses = self.value(theta, batch, learned)
        total = losses.mean() if self.shared else losses.sum()
        grads = torch.autograd.grad(total, list(theta.values()), create_graph=graph, materialize_grads=True)
        return dict(zip(theta, grads, strict=True)), losses.detach()


class UpdateRule(NamedTuple):
    """An optimiser as pure functions and their hyperparameters.

    Attributes:
        alpha: hyperparameters by name, [K, ...]: step i uses entry min(i, K - 1), so K = 1 is the same at every step.
            Those named `loss.*` go to the loss instead of the rule.
        init: theta -> state.
        step: (alpha at this step, theta, gradient, state) -> (theta, state).
    """

    alpha: Params
    init: Callable[[Params], Params]
    step: RuleStep


def at_step(alpha: Params, i: int) -> Params:
    """The hyperparameters of step i."""
    return {key: value[min(i, value.shape[0] - 1)] for key, value in alpha.items()}


def loss_parameters(alpha: Params) -> Params:
    """The learned parameters of the loss among hyperparameters."""
    return {key[5:]: value for key, value in alpha.items() if key.startswith("loss.")}


def same(theta: Params) -> Params:
    """Parameters as they are."""
    return theta


class Stepper(NamedTuple):
    """One step of a rule down a loss, and its vector-Jacobian product.

    Attributes:
        theta: the initialisation, as steps have it; differentiable in what it was made of.
        alpha: the same of the rule's hyperparameters, [K, ...].
        init: theta -> state.
        step: (alpha, theta, state, batch) -> (theta, state, losses, gradient).
        step_vjp: (alpha, theta, state, needed, pull_theta, pull_state) -> pulls of (theta, state, alpha).
        needed: (batch, gradient) -> what `step_vjp` needs of both: the batch for order 2, which differentiates the
            gradient; for order 1 the gradient, which is a constant.
        unpack: theta as steps have it -> theta by parameter, differentiable.
    """

    theta: Params
    alpha: Params
    init: Callable[[Params], Params]
    step: ForwardStep
    step_vjp: BackwardStep
    needed: Callable[[AnyBatch, AnyBatch], AnyBatch]
    unpack: Callable[[Params], Params] = same


@dataclass(frozen=True)
class Engine:
    """The engine that takes steps: here torch, by automatic differentiation; an extension may have another."""

    def stepper(self, rule: UpdateRule, loss: Loss, theta: Params, order: int = 1) -> Stepper:
        """The stepper of a rule down a loss from theta, backpropagated through to an order."""
        step, step_vjp = self.functions(rule.step, loss, order)
        return Stepper(
            theta, rule.alpha, rule.init, step, step_vjp, lambda batch, gradient: batch if order == 2 else gradient
        )

    def functions(self, step: RuleStep, loss: Loss, order: int) -> tuple[ForwardStep, BackwardStep]:
        """`step` and `step_vjp` of a Stepper, of a rule's step."""
        return steps_by_torch(step, loss, order)

    def value(self, loss: Loss, theta: Params, batch: AnyBatch) -> Tensor:
        """A loss [T], differentiable once in theta."""
        return loss.value(theta, batch, {})


TORCH = Engine()


def fastest(*, compiles: bool = False) -> Engine:
    """The engine of an extension; torch's where there is none.

    Args:
        compiles: whether the steps are so many that compiling them pays.
    """
    entry = registry().engine
    engine: Engine = entry.load()(compiles) if entry else TORCH
    return engine


def steps_by_torch(rule_step: RuleStep, loss: Loss, order: int) -> tuple[ForwardStep, BackwardStep]:
    """`step` and `step_vjp` of a Stepper; the only two functions that are worth compiling."""

    def step(alpha: Params, theta: Params, state: Params, batch: AnyBatch) -> tuple[Params, Params, Tensor, Params]:
        grads, losses = loss.gradient(theta, batch, loss_parameters(alpha), graph=False)
        with torch.no_grad():
            moved, state = rule_step(alpha, theta, grads, state)
        return moved, state, losses, grads

    def step_vjp(
        alpha: Params, theta: Params, state: Params, needed: AnyBatch, pull_theta: Params, pull_state: Params
    ) -> tuple[Params, Params, Params]:
        alpha, theta, state = _leaves(alpha), _leaves(theta), _leaves(state)
        grads = loss.gradient(theta, needed, loss_parameters(alpha), graph=True)[0] if order == 2 else needed
        moved, after = rule_step(alpha, theta, grads, state)
        outputs = [*moved.values(), *(after[key] for key in state)]
        pulls = [*(pull_theta[key] for key in moved), *(pull_state[key] for key in state)]
        inputs = [*theta.values(), *state.values(), *alpha.values()]
        live = [pair for pair in zip(outputs, pulls, strict=True) if pair[0].requires_grad]
        grads = iter(torch.autograd.grad([o for o, _ in live], inputs, [p for _, p in live], materialize_grads=True))
        return dict(zip(theta, grads)), dict(zip(state, grads)), dict(zip(alpha, grads))  # noqa: B905

    return torch.enable_grad()(step), torch.enable_grad()(step_vjp)


def _leaves(params: Params) -> Params:
    return {key: value.detach().requires_grad_() for key, value in params.items()}


class _LearnThrough(torch.autograd.Function):
    """K steps of learning as one node of the graph: keeps the K states, backpropagates one recomputed at a time."""

    stepper: Stepper
    alpha: Params
    taken: list[tuple[Params, Params, AnyBatch]]
    last_state: Params

    @staticmethod
    def forward(
        ctx: _LearnThrough, stepper: Stepper, batches: Sequence[AnyBatch], *leaves: Tensor
    ) -> tuple[Tensor, ...]:
        values = (leaf.detach() for leaf in leaves)
        theta, ctx.alpha = ({key: next(values) for key in tree} for tree in (stepper.theta, stepper.alpha))
        state = stepper.init(theta)
        ctx.stepper, ctx.taken = stepper, []
        for i, batch in enumerate(batches):
            before = (theta, state)
            theta, state, _, gradient = stepper.step(at_step(ctx.alpha, i), theta, state, batch)
            ctx.taken.append((*before, stepper.needed(batch, gradient)))
        ctx.last_state = state
        return tuple(theta[key] for key in theta)

    @staticmethod
    @once_differentiable
    def backward(ctx: _LearnThrough, *pulls: Tensor) -> tuple[Tensor | None, ...]:
        pull_theta = dict(zip(ctx.taken[0][0], (pull.contiguous() for pull in pulls), strict=True))
        pull_state = {key: torch.zeros_like(value) for key, value in ctx.last_state.items()}
        pull_alpha = {key: torch.zeros_like(value) for key, value in ctx.alpha.items()}
        for i in reversed(range(len(ctx.taken))):
            pull_theta, pull_state, pulled = ctx.stepper.step_vjp(
                at_step(ctx.alpha, i), *ctx.taken.pop(), pull_theta, pull_state
            )
            for key, value in pulled.items():
                pull_alpha[key][min(i, pull_alpha[key].shape[0] - 1)].add_(value)
        return None, None, *pull_theta.values(), *pull_alpha.values()


def learn_through(
    theta: Params, rule: UpdateRule, batches: Sequence[AnyBatch], loss: Loss, *, order: int, engine: Engine = TORCH
) -> Params:
    """Learn on given batches, differentiably in the initialisation and in the rule's alpha.

    The gradient is the adjoint recursion over the steps: memory is one step's graph and K copies of the parameters
    and of the rule's state. Order 1 treats each step's gradient as a constant (FOMAML); order 2 is exact (MAML).
    """
    stepper = engine.stepper(rule, loss, theta, order)
    apply: Callable[..., tuple[Tensor, ...]] = _LearnThrough.apply
    final = apply(stepper, batches, *stepper.theta.values(), *stepper.alpha.values())
    return stepper.unpack(dict(zip(stepper.theta, final, strict=True)))
