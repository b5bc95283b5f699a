"""Steps of learning in C (`step.c`) for the NBRDF network and for rules all of whose parts have a form in C.

The loss is in C as well (`nbrdf`). Steps by torch are the reference, from which results differ by rounding. The
parameters that steps in C return are views of one tensor [T, P], see
:class:`metapp.extensions.native.packing.FlatParameters`. Nothing outside of this package knows the layout of the
arguments of `step.c`.
"""

from __future__ import annotations

import ctypes
import functools
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from typing_extensions import override

from metapp.extensions.native import nbrdf
from metapp.extensions.native.compiler import load_library
from metapp.extensions.native.packing import ParameterOrder, pack_hyperparameters
from metapp.learning.adjoint import Loss, Steps, UpdateRule, add_smoothing, select_loss_parameters
from metapp.learning.task import Batch, Params


class _Shape(ctypes.Structure):
    _fields_ = [(name, ctypes.c_int) for name in ("rows", "columns", "left", "right")]


class _Alpha(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("rate", "adam", "matrices")),
        *((name, ctypes.c_long) for name in ("rate_by_task", "rate_by_weight", "adam_by_task", "matrices_by_task")),
    ]


class _Pulled(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ("rate", "adam", "matrices")]


class _State(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ("m", "v", "products")]


def make_c_steps(rule: UpdateRule, loss: Loss, theta: Params, order: int) -> Steps | None:
    """Make steps in C for a rule and a loss.

    Args:
        rule: the rule, with its hyperparameters.
        loss: the loss that steps follow.
        theta: parameters [T, ...], whose names and shapes count.
        order: 2 if steps are differentiated through the gradient, else 1.

    Returns:
        The steps; None if the loss or a part of the rule has no form in C, or if there is no compiler.
    """
    if not nbrdf.has_c_loss(loss, theta) or load_step_library() is None:
        return None
    parameter_order = ParameterOrder({name: theta[name] for name in nbrdf.NBRDF_PARAMETER_SHAPES})
    alpha = pack_hyperparameters(rule.step, rule.alpha, parameter_order)
    if alpha is None:
        return None
    c_steps = _CSteps(parameter_order, loss, order, moments="adam" in alpha)
    return Steps(alpha, c_steps.init, c_steps.value, c_steps.step, c_steps.vjp)


class _LossValue(torch.autograd.Function):
    """The loss in C as a function that autograd can differentiate once: its gradient is computed with it."""

    @staticmethod
    @override
    def forward(ctx: Any, theta: Tensor, batch: Batch) -> Tensor:
        ctx.gradient, losses = nbrdf.loss_gradient(theta.detach(), batch, {})
        return losses

    @staticmethod
    @once_differentiable
    @override
    def backward(ctx: Any, pull: Tensor) -> tuple[Tensor, None]:
        return pull[:, None] * ctx.gradient, None


@functools.cache
def load_step_library(march: str = "native") -> ctypes.CDLL | None:
    """Load the functions of `step.c`, compiled if need be.

    Args:
        march: the instruction set, a name that the compiler knows; native is this CPU's.

    Returns:
        The library; None if there is no compiler for these instructions.
    """
    result = load_library(Path(__file__).with_name("step.c"), "step", "step_back", march=march)
    if result is not None:
        counts, pointer = [ctypes.c_int] * 3, ctypes.c_void_p
        result.step.argtypes = [*counts, *[pointer] * 7]
        result.step_back.argtypes = [*counts, *[pointer] * 9]
    return result


class _CSteps:
    """The functions of :class:`metapp.learning.adjoint.Steps` in C, for parameters of one order and shape.

    Args:
        parameter_order: the order of parameters in flat tensors.
        loss: the loss, of which the smoothing of second derivatives counts.
        order: 2 if steps are differentiated through the gradient, else 1.
        moments: whether the rule keeps Adam's moments.
    """

    def __init__(self, parameter_order: ParameterOrder, loss: Loss, order: int, *, moments: bool) -> None:
        self.parameter_order, self.loss, self.order, self.moments = parameter_order, loss, order, moments
        library = load_step_library()
        assert library is not None, "steps in C are offered with the library alone"
        self.functions = library
        shapes = [
            (*shape, shape[0] > 1, shape[1] > 1) if len(shape) == 2 else (1, parameter_order.sizes[key], False, False)
            for key, shape in parameter_order.shapes.items()
        ]
        self.shapes = parameter_order.size, len(shapes), (_Shape * len(shapes))(*(_Shape(*shape) for shape in shapes))

    def init(self, theta: Params) -> Params:
        """Return Adam's initial moments [T, P] and products of betas [T, 2]; nothing if the rule has no Adam."""
        if not self.moments:
            return {}
        zeros = next(iter(theta.values())).new_zeros
        tasks = len(next(iter(theta.values())))
        state = {"m": zeros(tasks, self.parameter_order.size), "v": zeros(tasks, self.parameter_order.size)}
        return state | {"products": zeros(tasks, 2) + 1}

    def value(self, theta: Params, batch: Batch) -> Tensor:
        """Return the loss of each task, [T], differentiable once in theta."""
        result: Tensor = _LossValue.apply(self.parameter_order.flatten(theta), batch)  # type: ignore[no-untyped-call]
        return result

    def step(self, alpha: Params, theta: Params, state: Params, batch: Batch) -> tuple[Params, Params, Tensor, Params]:
        """Take one step.

        Args:
            alpha: the step's hyperparameters, see :func:`pack_hyperparameters`.
            theta: parameters [T, ...].
            state: Adam's moments and products of betas, see :meth:`init`.
            batch: samples of the loss.

        Returns:
            Parameters and state after the step, the losses before it, [T], and the gradient, "flat" [T, P].
        """
        flat = self.parameter_order.flatten(theta)
        gradient, losses = nbrdf.loss_gradient(flat, batch, select_loss_parameters(alpha))
        moved_flat, moved_state = torch.empty_like(flat), {key: torch.empty_like(value) for key, value in state.items()}
        alpha_pointers = _point_at_hyperparameters(alpha)
        self.functions.step(
            flat.shape[0], *self.shapes, ctypes.byref(alpha_pointers), flat.data_ptr(), gradient.data_ptr(),
            _point_at(_State, state), moved_flat.data_ptr(), _point_at(_State, moved_state),
        )  # fmt: skip
        return self.parameter_order.unflatten(moved_flat), moved_state, losses, {"flat": gradient}

    def vjp(
        self,
        alpha: Params,
        theta: Params,
        state: Params,
        batch: Batch,
        gradient: Params,
        pull_theta: Params,
        pull_state: Params,
    ) -> tuple[Params, Params, Params]:
        """Pull cotangents of the results of a step back to its arguments.

        Args:
            alpha: the step's hyperparameters.
            theta: parameters before the step, [T, ...].
            state: the state before the step.
            batch: samples of the loss; {} for order 1, which does not read them.
            gradient: the gradient that the step followed, "flat" [T, P].
            pull_theta: cotangents of the parameters after the step.
            pull_state: cotangents of the state after the step.

        Returns:
            Cotangents of theta, state and alpha.
        """
        pull, flat_gradient = self.parameter_order.flatten(pull_theta), gradient["flat"]
        alpha_pointers = _point_at_hyperparameters(alpha)
        pull_gradient = torch.empty_like(flat_gradient)
        pull_old_state = {key: torch.empty_like(value) for key, value in state.items()}
        sizes = {key: alpha[key].shape[-1] for key in ("adam", "matrices") if key in alpha} | {
            "rate": flat_gradient.shape[1]
        }
        pulls: Params = {key: flat_gradient.new_empty(flat_gradient.shape[0], size) for key, size in sizes.items()}
        self.functions.step_back(
            flat_gradient.shape[0], *self.shapes, ctypes.byref(alpha_pointers), flat_gradient.data_ptr(),
            _point_at(_State, state), pull.data_ptr(), _point_at(_State, pull_state), pull_gradient.data_ptr(),
            _point_at(_State, pull_old_state), _point_at(_Pulled, pulls),
        )  # fmt: skip
        if self.order == 2:
            flat, loss_parameters = self.parameter_order.flatten(theta), select_loss_parameters(alpha)
            smooth = add_smoothing(self.loss, loss_parameters, {"flat": flat})
            product, pull_learned = nbrdf.gradient_product(flat, batch, smooth, pull_gradient)
            pull = pull + product
            pulls |= {f"loss.{key}": pull_learned[key] for key in loss_parameters}
        pull_alpha = {key: pulls[key].sum_to_size(alpha[key].shape) for key in pulls}
        return self.parameter_order.unflatten(pull), pull_old_state, pull_alpha


def _point_at(kind: type[ctypes.Structure], tensors: Params) -> object:
    """Return a reference to a structure of pointers to dense tensors; names without a tensor are null."""
    return ctypes.byref(kind(**{key: value.data_ptr() for key, value in tensors.items()}))


def _point_at_hyperparameters(alpha: Params) -> _Alpha:
    """Return pointers to one step's hyperparameters [T or 1, n], and their strides.

    The last axis must be dense, unless it is 1; strides are 0 where tasks or weights share a hyperparameter.
    """
    pointers, strides = [], []
    for key in ("rate", "adam", "matrices"):
        value = alpha.get(key)
        pointers.append(None if value is None else value.data_ptr())
        strides.append(0 if value is None or value.shape[0] == 1 else value.stride(0))
    return _Alpha(*pointers, strides[0], int(alpha["rate"].shape[-1] > 1), *strides[1:])
