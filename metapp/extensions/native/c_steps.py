"""Steps in C (`step.c`) of the NBRDF network, whose loss is in C (`nbrdf`), and of rules whose parts are there.

Steps by torch are the reference, from which results differ by rounding. The trees that steps in C return are views of
one tensor [T, P] (`packing.Flat`).
"""

from __future__ import annotations

import ctypes
import functools
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from metapp.extensions.native import nbrdf
from metapp.extensions.native.compiler import load_library
from metapp.extensions.native.packing import ParameterOrder, packed
from metapp.learning.adjoint import Loss, Steps, UpdateRule, select_loss_parameters
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
    """Steps in C; None if the loss or a part of the rule has no such form, or without a compiler."""
    if not nbrdf.has_c_loss(loss, theta) or load_step_library() is None:
        return None
    layout = ParameterOrder({name: theta[name] for name in nbrdf.NBRDF_PARAMETER_SHAPES})
    alpha = packed(rule.step, rule.alpha, layout)
    if alpha is None:
        return None
    by = _Steps(layout, order, moments="adam" in alpha)
    return Steps(alpha, by.init, by.value, by.step, by.vjp)


class _Value(torch.autograd.Function):
    """A loss in C, whose gradient comes with it."""

    @staticmethod
    def forward(ctx: Any, theta: Tensor, batch: Batch) -> Tensor:
        ctx.gradient, losses = nbrdf.loss_gradient(theta.detach(), batch, {})
        return losses

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, pull: Tensor) -> tuple[Tensor, None]:
        return pull[:, None] * ctx.gradient, None


@functools.cache
def load_step_library(march: str = "native") -> ctypes.CDLL | None:
    """The functions of `step.c` by the instructions of a CPU; None if there is no compiler for it."""
    result = load_library(Path(__file__).with_name("step.c"), "step", "step_back", march=march)
    if result is not None:
        counts, pointer = [ctypes.c_int] * 3, ctypes.c_void_p
        result.step.argtypes = [*counts, *[pointer] * 7]
        result.step_back.argtypes = [*counts, *[pointer] * 9]
    return result


class _Steps:
    """One step in C, forward and backward."""

    def __init__(self, layout: ParameterOrder, order: int, *, moments: bool) -> None:
        self.layout, self.order, self.moments = layout, order, moments
        functions = load_step_library()
        assert functions is not None, "steps in C are offered with the library alone"
        self.functions = functions
        shapes = [
            (*shape, shape[0] > 1, shape[1] > 1) if len(shape) == 2 else (1, layout.sizes[key], False, False)
            for key, shape in layout.shapes.items()
        ]
        self.shapes = layout.size, len(shapes), (_Shape * len(shapes))(*(_Shape(*shape) for shape in shapes))

    def init(self, theta: Params) -> Params:
        """Adam's moments [T, P], and the products of its betas [T, 2]; nothing without an Adam."""
        if not self.moments:
            return {}
        zeros = next(iter(theta.values())).new_zeros
        tasks = len(next(iter(theta.values())))
        state = {"m": zeros(tasks, self.layout.size), "v": zeros(tasks, self.layout.size)}
        return state | {"products": zeros(tasks, 2) + 1}

    def value(self, theta: Params, batch: Batch) -> Tensor:
        """As of `Steps`."""
        result: Tensor = _Value.apply(self.layout.flat(theta), batch)  # type: ignore[no-untyped-call]
        return result

    def step(self, alpha: Params, theta: Params, state: Params, batch: Batch) -> tuple[Params, Params, Tensor, Params]:
        """As of `Steps`."""
        flat = self.layout.flat(theta)
        grads, losses = nbrdf.loss_gradient(flat, batch, select_loss_parameters(alpha))
        moved, after = torch.empty_like(flat), {key: torch.empty_like(value) for key, value in state.items()}
        tree = _alpha(alpha)
        self.functions.step(
            flat.shape[0], *self.shapes, ctypes.byref(tree), flat.data_ptr(), grads.data_ptr(),
            _reference(_State, state), moved.data_ptr(), _reference(_State, after),
        )  # fmt: skip
        return self.layout.tree(moved), after, losses, {"flat": grads}

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
        """As of `Steps`."""
        pull, grads, tree = self.layout.flat(pull_theta), gradient["flat"], _alpha(alpha)
        by_grads, by_state = torch.empty_like(grads), {key: torch.empty_like(value) for key, value in state.items()}
        sizes = {key: alpha[key].shape[-1] for key in ("adam", "matrices") if key in alpha} | {"rate": grads.shape[1]}
        pulled: Params = {key: grads.new_empty(grads.shape[0], size) for key, size in sizes.items()}
        self.functions.step_back(
            grads.shape[0], *self.shapes, ctypes.byref(tree), grads.data_ptr(), _reference(_State, state),
            pull.data_ptr(), _reference(_State, pull_state), by_grads.data_ptr(), _reference(_State, by_state),
            _reference(_Pulled, pulled),
        )  # fmt: skip
        if self.order == 2:
            flat = self.layout.flat(theta)
            product, by_learned = nbrdf.gradient_product(flat, batch, select_loss_parameters(alpha), by_grads)
            pull = pull + product
            pulled |= {f"loss.{key}": value for key, value in by_learned.items()}
        by_alpha = {key: pulled[key].sum_to_size(alpha[key].shape) for key in pulled}
        return self.layout.tree(pull), by_state, by_alpha


def _reference(kind: type[ctypes.Structure], tensors: Params) -> object:
    """A structure of pointers to dense tensors, null if there is none of that name."""
    return ctypes.byref(kind(**{key: value.data_ptr() for key, value in tensors.items()}))


def _alpha(alpha: Params) -> _Alpha:
    """Where one step's hyperparameters lie: [T or 1, n], of which the last axis is dense, unless it is 1."""
    pointers, strides = [], []
    for key in ("rate", "adam", "matrices"):
        value = alpha.get(key)
        pointers.append(None if value is None else value.data_ptr())
        strides.append(0 if value is None or value.shape[0] == 1 else value.stride(0))
    return _Alpha(*pointers, strides[0], int(alpha["rate"].shape[-1] > 1), *strides[1:])
