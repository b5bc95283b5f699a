"""One step of learning, and differentiating through many: the adjoint recursion, one step at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from metapp.learning.task import Params

AnyData = Any  # the source of a loss's samples: tasks, most often
AnyBatch = Any  # its samples: tensors by name, or a tuple of such
RuleStep = Callable[[Params, Params, Params, Params], tuple[Params, Params]]


class DrawnBatch(NamedTuple):
    """A batch, and the names of the tasks whose samples it holds."""

    names: tuple[str, ...]
    batch: AnyBatch


@dataclass(frozen=True)
class Loss:
    """A loss (alg. 2): `draw` holds all randomness, `value` is deterministic, differentiated and compiled.

    Attributes:
        draw: (data, rng, done) -> Draw; all randomness is here; rng is a generator, or one for each task (`draws`);
            done is the share of the descent's steps that were taken, in [0, 1]: at 1 all of the data is drawn from.
        value: (params, batch, learned) -> the loss of each task, [T]; `learned` are its learned parameters.
        shared: True if all tasks share the parameters (the descent follows the mean over tasks), False if
            each task has its own (it follows the sum, which moves each as if it were alone).

    >>> loss = Loss(lambda data, rng, done: Draw((), {}), lambda theta, batch, learned: theta["x"].square())
    >>> loss.gradient({"x": torch.tensor([3.0])}, {}, {}, graph=False)
    ({'x': tensor([6.])}, tensor([9.]))
    """

    draw: Callable[[AnyData, Any, float], DrawnBatch]
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
    """The hyperparameters of step i.

    >>> at_step({"rate": torch.tensor([0.5, 0.25])}, 7)
    {'rate': tensor(0.2500)}
    """
    return {key: value[min(i, value.shape[0] - 1)] for key, value in alpha.items()}


def select_loss_parameters(alpha: Params) -> Params:
    """The learned parameters of the loss among hyperparameters.

    >>> loss_parameters({"rate": torch.ones(1), "loss.smoothing": torch.zeros(1)})
    {'smoothing': tensor([0.])}
    """
    return {key[5:]: value for key, value in alpha.items() if key.startswith("loss.")}


class Steps(NamedTuple):
    """Steps of a rule down a loss, their vector-Jacobian product, and the loss itself.

    Attributes:
        alpha: the rule's hyperparameters as the steps read them, [K, ...]; differentiable in the rule's own.
        init: theta -> state.
        value: (theta, batch) -> the plain loss of each task, [T], differentiable once in theta.
        step: (alpha of this step, theta, state, batch) -> (theta, state, losses [T], gradient).
        vjp: (alpha, theta, state, batch, gradient, cotangents of both results) -> those of theta, state and alpha;
            the batch is {} for order 1, which does not read it.
    """

    alpha: Params
    init: Callable[[Params], Params]
    value: Callable[[Params, AnyBatch], Tensor]
    step: Callable[[Params, Params, Params, AnyBatch], tuple[Params, Params, Tensor, Params]]
    vjp: Callable[[Params, Params, Params, AnyBatch, Params, Params, Params], tuple[Params, Params, Params]]


# (rule, loss, theta, order) -> steps from parameters of these shapes; order 2 differentiates the gradient, 1 does not
StepsOf = Callable[[UpdateRule, Loss, Params, int], Steps]


def torch_steps(rule: UpdateRule, loss: Loss, theta: Params, order: int) -> Steps:
    """Steps by automatic differentiation; the reference of all others.

    >>> from metapp.learning.rules import sgd
    >>> loss = Loss(lambda data, rng, done: Draw((), {}), lambda theta, batch, learned: theta["x"].square())
    >>> theta = {"x": torch.ones(1)}
    >>> steps = torch_steps(sgd({"rate": torch.tensor([0.25])}), loss, theta, 1)
    >>> moved, state, losses, gradient = steps.step(at_step(steps.alpha, 0), theta, steps.init(theta), {})
    >>> moved, losses, gradient
    ({'x': tensor([0.5000])}, tensor([1.]), {'x': tensor([2.])})
    """
    return Steps(
        rule.alpha, rule.init, lambda theta, batch: loss.value(theta, batch, {}), *step_and_vjp(rule.step, loss, order)
    )


def step_and_vjp(rule_step: RuleStep, loss: Loss, order: int) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """`step` and `vjp` of `Steps`; the only two functions that are worth compiling."""

    def step(alpha: Params, theta: Params, state: Params, batch: AnyBatch) -> tuple[Params, Params, Tensor, Params]:
        grads, losses = loss.gradient(theta, batch, select_loss_parameters(alpha), graph=False)
        with torch.no_grad():
            moved, state = rule_step(alpha, theta, grads, state)
        return moved, state, losses, grads

    def vjp(
        alpha: Params,
        theta: Params,
        state: Params,
        batch: AnyBatch,
        grads: Params,
        d_theta: Params,
        d_state: Params,
    ) -> tuple[Params, Params, Params]:
        alpha, theta, state = _leaves(alpha), _leaves(theta), _leaves(state)
        if order == 2:
            grads = loss.gradient(theta, batch, select_loss_parameters(alpha), graph=True)[0]
        moved, after = rule_step(alpha, theta, grads, state)
        outputs = [*moved.values(), *(after[key] for key in state)]
        d_outputs = [*(d_theta[key] for key in moved), *(d_state[key] for key in state)]
        inputs = [*theta.values(), *state.values(), *alpha.values()]
        live = [pair for pair in zip(outputs, d_outputs, strict=True) if pair[0].requires_grad]
        outputs, d_outputs = ([pair[i] for pair in live] for i in (0, 1))
        d_inputs = iter(torch.autograd.grad(outputs, inputs, d_outputs, materialize_grads=True))
        return dict(zip(theta, d_inputs)), dict(zip(state, d_inputs)), dict(zip(alpha, d_inputs))  # noqa: B905

    return torch.enable_grad()(step), torch.enable_grad()(vjp)


def _leaves(params: Params) -> Params:
    return {key: value.detach().requires_grad_() for key, value in params.items()}


class _LearnThrough(torch.autograd.Function):
    """K steps of learning as one node of the graph: keeps the K states, backpropagates one recomputed at a time."""

    steps: Steps
    names: Sequence[str]
    alpha: Params
    taken: list[tuple[Params, Params, AnyBatch, Params]]
    last_state: Params

    @staticmethod
    def forward(
        ctx: _LearnThrough, steps: Steps, order: int, names: Sequence[str], batches: Sequence[AnyBatch], *leaves: Tensor
    ) -> tuple[Tensor, ...]:
        values = (leaf.detach() for leaf in leaves)
        theta, ctx.alpha = ({key: next(values) for key in keys} for keys in (names, steps.alpha))
        state = steps.init(theta)
        ctx.steps, ctx.names, ctx.taken = steps, names, []
        for i, batch in enumerate(batches):
            before = (theta, state)
            theta, state, _, grads = steps.step(at_step(ctx.alpha, i), theta, state, batch)
            ctx.taken.append((*before, batch if order == 2 else {}, grads))
        ctx.last_state = state
        return tuple(theta[key] for key in names)

    @staticmethod
    @once_differentiable
    def backward(ctx: _LearnThrough, *d_final: Tensor) -> tuple[Tensor | None, ...]:
        d_theta = dict(zip(ctx.names, (value.contiguous() for value in d_final), strict=True))
        d_state = {key: torch.zeros_like(value) for key, value in ctx.last_state.items()}
        d_alpha = {key: torch.zeros_like(value) for key, value in ctx.alpha.items()}
        for i, taken in reversed(list(enumerate(ctx.taken))):
            alpha = at_step(ctx.alpha, i)
            d_theta, d_state, d_alpha_i = ctx.steps.vjp(alpha, *taken, d_theta, d_state)
            for key, value in d_alpha_i.items():
                d_alpha[key][min(i, d_alpha[key].shape[0] - 1)].add_(value)
        return None, None, None, None, *(d_theta[key] for key in ctx.names), *d_alpha.values()


def learn_differentiably(
    theta: Params,
    rule: UpdateRule,
    batches: Sequence[AnyBatch],
    loss: Loss,
    *,
    order: int,
    steps_of: StepsOf = torch_steps,
) -> Params:
    """Learn on given batches, differentiably in the initialisation and in the rule's alpha.

    The gradient is the adjoint recursion over the steps: memory is one step's graph and K copies of the parameters,
    of their gradient and of the rule's state. Order 1 treats each step's gradient as a constant (FOMAML); order 2 is
    exact (MAML).

    >>> from metapp.learning.rules import sgd
    >>> loss = Loss(lambda data, rng, done: Draw((), {}), lambda theta, batch, learned: theta["x"].square())
    >>> x = torch.ones(1, requires_grad=True)
    >>> theta = learn_through({"x": x}, sgd({"rate": torch.tensor([0.25])}), [{}, {}], loss, order=2)
    >>> torch.autograd.grad(theta["x"], x)
    (tensor([0.2500]),)
    """
    steps = steps_of(rule, loss, theta, order)
    apply: Callable[..., tuple[Tensor, ...]] = _LearnThrough.apply
    final = apply(steps, order, list(theta), batches, *theta.values(), *steps.alpha.values())
    return dict(zip(theta, final, strict=True))
