"""One step of learning, and derivatives through many steps by the adjoint recursion.

Meta-learning differentiates a loss at the end of a fit in the fit's initialisation and hyperparameters. The graph of
all steps together would not fit into memory; here the states of all steps are kept, and each step's graph is
recomputed when its derivatives are needed. Other implementations of a step, such as one in C, provide the functions of
:class:`Steps`. This module knows neither tasks nor applications: a loss is two functions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from typing_extensions import override

from metapp.learning.task import Params, select_prefixed

AnyData = Any  # the source that a loss draws samples from, most often tasks
AnyBatch = Any  # drawn samples: tensors by name, or a tuple of such batches
RuleStep = Callable[[Params, Params, Params, Params], tuple[Params, Params]]


class DrawnBatch(NamedTuple):
    """A batch of samples, and the names of the tasks that they are samples of.

    Attributes:
        names: the names of the tasks.
        batch: the samples, by which the function `value` of a :class:`Loss` computes the loss.
    """

    names: tuple[str, ...]
    batch: AnyBatch


@dataclass(frozen=True)
class Loss:
    """A loss (alg. 2 in the paper), as a random function that draws and a deterministic one that is differentiated.

    Attributes:
        draw: a function (data, rng, done) -> :class:`DrawnBatch`, the only one that draws random numbers. `rng` is a
            generator, or one for each task (see :mod:`metapp.learning.random_tensors`). `done` is the share of the
            descent's steps that were taken, in [0, 1]; at 1 the batch is drawn from all of the data.
        value: a function (params, batch, loss_parameters) -> the loss of each task, [T]. It is deterministic, and is
            differentiated and compiled. A rule has learned the loss parameters; {} gives the plain loss.
        shared: whether all tasks share their parameters, so that a descent follows the gradient of the mean over tasks.
            Otherwise each task has parameters for itself, and a descent follows the gradient of the sum, which moves
            each task as if it were alone.
        smoothing: the smoothing s of absolute differences in second derivatives. There sqrt(d^2 + s^2) - s stands for
            |d|, if the function `value` knows the loss parameter `smoothing`, log s; losses and gradients stay as they
            are. The slope of a mean of |d| changes as differences change sign, which automatic differentiation does
            not see at the kink of |d|. 0 for second derivatives of the loss as it is.

    >>> loss = Loss(lambda data, rng, done: DrawnBatch((), {}), lambda theta, batch, _: theta["x"].square())
    >>> loss.gradient({"x": torch.tensor([3.0])}, {}, {}, graph=False)
    ({'x': tensor([6.])}, tensor([9.]))
    """

    draw: Callable[[AnyData, Any, float], DrawnBatch]
    value: Callable[[Params, AnyBatch, Params], Tensor]
    shared: bool = False
    smoothing: float = 0.0

    def gradient(
        self, theta: Params, batch: AnyBatch, loss_parameters: Params, *, graph: bool
    ) -> tuple[Params, Tensor]:
        """Return the gradient that a step follows, and the detached loss of each task, [T].

        Args:
            theta: parameters, [T, ...] unless tasks share them.
            batch: a batch that `draw` returned.
            loss_parameters: the values that a rule has learned.
            graph: whether the gradient is going to be differentiated itself.
        """
        theta = theta if graph else _detach_leaves(theta)
        losses = self.value(theta, batch, loss_parameters)
        total = losses.mean() if self.shared else losses.sum()
        grads = torch.autograd.grad(total, list(theta.values()), create_graph=graph, materialize_grads=True)
        return dict(zip(theta, grads, strict=True)), losses.detach()


class UpdateRule(NamedTuple):
    """An optimiser, as pure functions and their hyperparameters.

    Attributes:
        alpha: hyperparameters by name, [K, ...]: step i uses entry min(i, K - 1), so that K = 1 means equal values at
            all steps. Hyperparameters named `loss.*` are parameters of the loss, not of the rule.
        init: a function theta -> the rule's state before the first step.
        step: a function (alpha of this step, theta, gradient, state) -> (theta, state).
    """

    alpha: Params
    init: Callable[[Params], Params]
    step: RuleStep


def at_step(alpha: Params, i: int) -> Params:
    """Select the hyperparameters of step i.

    >>> at_step({"rate": torch.tensor([0.5, 0.25])}, 7)
    {'rate': tensor(0.2500)}
    """
    return {key: value[min(i, value.shape[0] - 1)] for key, value in alpha.items()}


def select_loss_parameters(alpha: Params) -> Params:
    """Select the loss parameters among hyperparameters, without the prefix of their names.

    >>> select_loss_parameters({"rate": torch.ones(1), "loss.smoothing": torch.zeros(1)})
    {'smoothing': tensor([0.])}
    """
    return select_prefixed(alpha, "loss.")


def add_smoothing(loss: Loss, loss_parameters: Params, theta: Params) -> Params:
    """Add to a step's loss parameters the smoothing of second derivatives, [T], if the rule has learned none.

    Args:
        loss: the loss, whose `smoothing` may be 0.
        loss_parameters: the values that the rule has learned.
        theta: parameters [T, ...].

    >>> loss = Loss(lambda data, rng, done: DrawnBatch((), {}), lambda theta, batch, _: theta["x"], smoothing=1.0)
    >>> add_smoothing(loss, {}, {"x": torch.zeros(2)})
    {'smoothing': tensor([0., 0.])}
    """
    if not loss.smoothing:
        return loss_parameters
    first = next(iter(theta.values()))
    return {"smoothing": first.new_full((first.shape[0],), math.log(loss.smoothing))} | loss_parameters


class Steps(NamedTuple):
    """Steps of a rule down a loss, their vector-Jacobian product, and the loss itself.

    Attributes:
        alpha: the rule's hyperparameters as the steps read them, [K, ...]; differentiable in the hyperparameters of the
            rule.
        init: a function theta -> the rule's state before the first step.
        value: a function (theta, batch) -> the plain loss of each task, [T], differentiable once in theta.
        step: a function (alpha of this step, theta, state, batch) -> (theta, state, losses [T], gradient).
        vjp: a function (alpha of this step, theta, state, batch, gradient, cotangent of the new theta, cotangent of the
            new state) -> (cotangents of theta, state and alpha). The batch is {} for order 1, which does not read it.
    """

    alpha: Params
    init: Callable[[Params], Params]
    value: Callable[[Params, AnyBatch], Tensor]
    step: Callable[[Params, Params, Params, AnyBatch], tuple[Params, Params, Tensor, Params]]
    vjp: Callable[[Params, Params, Params, AnyBatch, Params, Params, Params], tuple[Params, Params, Params]]


# a function that makes steps: (rule, loss, theta, order) -> steps; see `torch_steps` for the arguments
StepMaker = Callable[[UpdateRule, Loss, Params, int], Steps]


def torch_steps(rule: UpdateRule, loss: Loss, theta: Params, order: int) -> Steps:
    """Make steps by automatic differentiation in torch, the reference for all other implementations.

    Args:
        rule: the update rule with its hyperparameters.
        loss: the loss that steps descend.
        theta: parameters [T, ...] of the shapes that steps will see; their values are not read.
        order: 2 differentiates the gradient of a step in the vector-Jacobian product, 1 treats it as a constant.

    >>> from metapp.learning.rules import sgd
    >>> loss = Loss(lambda data, rng, done: DrawnBatch((), {}), lambda theta, batch, _: theta["x"].square())
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
    """Return the functions `step` and `vjp` of :class:`Steps`, the only two that are worth compiling."""

    def step(alpha: Params, theta: Params, state: Params, batch: AnyBatch) -> tuple[Params, Params, Tensor, Params]:
        grads, losses = loss.gradient(theta, batch, select_loss_parameters(alpha), graph=False)
        with torch.no_grad():
            new_theta, state = rule_step(alpha, theta, grads, state)
        return new_theta, state, losses, grads

    def vjp(
        alpha: Params,
        theta: Params,
        state: Params,
        batch: AnyBatch,
        grads: Params,
        d_theta: Params,
        d_state: Params,
    ) -> tuple[Params, Params, Params]:
        alpha, theta, state = _detach_leaves(alpha), _detach_leaves(theta), _detach_leaves(state)
        if order == 2:
            loss_parameters = select_loss_parameters(alpha)
            smooth_grads = loss.gradient(theta, batch, add_smoothing(loss, loss_parameters, theta), graph=True)[0]
            # the gradient that the step followed, with the derivatives of the smooth one
            grads = {key: value + (grads[key] - value).detach() for key, value in smooth_grads.items()}
        new_theta, new_state = rule_step(alpha, theta, grads, state)
        outputs = [*new_theta.values(), *(new_state[key] for key in state)]
        d_outputs = [*(d_theta[key] for key in new_theta), *(d_state[key] for key in state)]
        inputs = [*theta.values(), *state.values(), *alpha.values()]
        # autograd refuses outputs that depend on none of the inputs
        differentiable = [pair for pair in zip(outputs, d_outputs, strict=True) if pair[0].requires_grad]
        outputs, d_outputs = ([pair[i] for pair in differentiable] for i in (0, 1))
        d_inputs = iter(torch.autograd.grad(outputs, inputs, d_outputs, materialize_grads=True))
        return dict(zip(theta, d_inputs)), dict(zip(state, d_inputs)), dict(zip(alpha, d_inputs))  # noqa: B905

    return torch.enable_grad()(step), torch.enable_grad()(vjp)


def _detach_leaves(params: Params) -> Params:
    """Detach parameters and make them leaves of a new graph."""
    return {key: value.detach().requires_grad_() for key, value in params.items()}


class _LearningNode(torch.autograd.Function):
    """Several steps of learning as one node of the graph.

    The forward pass keeps the state before each step. The backward pass recomputes one step's graph at a time.
    """

    steps: Steps
    names: Sequence[str]
    alpha: Params
    records: list[tuple[Params, Params, AnyBatch, Params]]
    last_state: Params  # the rule's state after the last step

    @staticmethod
    @override
    def forward(
        ctx: _LearningNode, steps: Steps, order: int, names: Sequence[str], batches: Sequence[AnyBatch], *leaves: Tensor
    ) -> tuple[Tensor, ...]:
        values = (leaf.detach() for leaf in leaves)
        theta, ctx.alpha = ({key: next(values) for key in keys} for keys in (names, steps.alpha))
        state = steps.init(theta)
        ctx.steps, ctx.names, ctx.records = steps, names, []
        for i, batch in enumerate(batches):
            before = (theta, state)
            theta, state, _, grads = steps.step(at_step(ctx.alpha, i), theta, state, batch)
            ctx.records.append((*before, batch if order == 2 else {}, grads))
        ctx.last_state = state
        # A result that is kept here, too, such as a parameter that no step changes, would refer to this node, and the
        # node to it: all records would stay in memory, 30 MB for each outer step of illumination.
        return tuple(theta[key].detach() for key in names)

    @staticmethod
    @once_differentiable
    @override
    def backward(ctx: _LearningNode, *d_final: Tensor) -> tuple[Tensor | None, ...]:
        d_theta = dict(zip(ctx.names, (value.contiguous() for value in d_final), strict=True))
        d_state = {key: torch.zeros_like(value) for key, value in ctx.last_state.items()}
        d_alpha = {key: torch.zeros_like(value) for key, value in ctx.alpha.items()}
        for i, record in reversed(list(enumerate(ctx.records))):
            alpha = at_step(ctx.alpha, i)
            d_theta, d_state, d_alpha_i = ctx.steps.vjp(alpha, *record, d_theta, d_state)
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
    make_steps: StepMaker = torch_steps,
) -> Params:
    """Learn on given batches, differentiably in the initialisation and in the rule's hyperparameters.

    The derivative is the adjoint recursion over the steps. It needs memory for the graph of one step, and for as many
    copies of the parameters, of their gradient and of the rule's state as there are batches.

    Args:
        theta: the initialisation, [T, ...].
        rule: the update rule; derivatives flow to its alpha.
        batches: the samples of each step, one batch a step.
        loss: the loss that steps descend.
        order: 2 is exact (MAML), 1 treats each step's gradient as a constant (FOMAML).
        make_steps: a function that makes the steps.

    Returns:
        The parameters after the last step, [T, ...].

    >>> from metapp.learning.rules import sgd
    >>> loss = Loss(lambda data, rng, done: DrawnBatch((), {}), lambda theta, batch, _: theta["x"].square())
    >>> x = torch.ones(1, requires_grad=True)
    >>> theta = learn_differentiably({"x": x}, sgd({"rate": torch.tensor([0.25])}), [{}, {}], loss, order=2)
    >>> torch.autograd.grad(theta["x"], x)
    (tensor([0.2500]),)
    """
    steps = make_steps(rule, loss, theta, order)
    apply: Callable[..., tuple[Tensor, ...]] = _LearningNode.apply
    final = apply(steps, order, list(theta), batches, *theta.values(), *steps.alpha.values())
    return dict(zip(theta, final, strict=True))
