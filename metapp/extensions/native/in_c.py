"""Steps in C (`step.c`), for small networks whose loss is in C, and rules whose parts are there.

Steps by torch are the reference, from which results differ by rounding. The descent and the adjoint recursion stay the
same: a `Stepper` on the tree {"theta": [T, P]}.
"""

from __future__ import annotations

import ctypes
import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from metapp import registry
from metapp.extensions.native.compiler import load
from metapp.extensions.native.packing import Layout, packed
from metapp.learning.adjoint import Loss, Stepper, UpdateRule, loss_parameters
from metapp.learning.task import Batch, Params

WIDEST, MOST = 64, 4096  # as in step.c: rows and columns of a parameter, weights of a task


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


class LossInC(NamedTuple):
    """A loss of flat parameters theta [T, P], float32, and its derivatives.

    Attributes:
        names: of the parameters, in theta's order.
        gradient: (theta, batch, learned) -> (gradient [T, P], loss of each task [T]).
        product: (theta, batch, learned, along [T, P]) -> the derivatives of the sum of gradient * along in theta, and
            in each learned parameter.
    """

    names: tuple[str, ...]
    gradient: Callable[[Tensor, Batch, Params], tuple[Tensor, Tensor]]
    product: Callable[[Tensor, Batch, Params, Tensor], tuple[Tensor, Params]]


# An application's method, which one that overrides it is not; and theta -> the same loss in C for parameters of these
# shapes, None where there is none or no compiler for it.
KERNELS = {"metapp.apps.brdf.app:Brdf.loss": "metapp.extensions.native.nbrdf:loss"}


def loss_in_c(loss: Loss, theta: Params) -> LossInC | None:
    """The same in C; None where the loss, the device or the numbers' type has no such form."""
    kernel = _kernel(getattr(loss.value, "__func__", loss.value))
    by_gradient = type(loss).gradient is Loss.gradient
    if (
        kernel is None
        or not by_gradient
        or any(value.dtype != torch.float32 or value.device.type != "cpu" for value in theta.values())
    ):
        return None
    return kernel(theta) if compiled() is not None else None


def _kernel(function: Callable[..., object]) -> Callable[[Params], LossInC | None] | None:
    name = f"{getattr(function, '__module__', '')}:{getattr(function, '__qualname__', '')}"
    if name not in KERNELS or registry.load(name) is not function:
        return None
    kernel: Callable[[Params], LossInC | None] = registry.load(KERNELS[name])
    return kernel


def stepper(rule: UpdateRule, loss: Loss, theta: Params, order: int) -> Stepper | None:
    """Steps in C; None where the loss or a part of the rule has no such form."""
    in_c = loss_in_c(loss, theta)
    if in_c is None:
        return None
    layout = Layout.of({name: theta[name] for name in in_c.names})
    alpha = packed(rule.step, rule.alpha, layout) if _fits(layout) else None
    if alpha is None:
        return None
    step = _Step(layout, in_c, order)
    return Stepper(
        {"theta": layout.flat(theta)},
        alpha,
        _first_state if "adam" in alpha else _no_state,
        step.forward,
        step.backward,
        step.needed,
        lambda theta: layout.tree(theta["theta"]),
    )


def value(loss: Loss, theta: Params, batch: Batch) -> Tensor | None:
    """A loss [T] in C, differentiable once in theta; None where it has no such form."""
    in_c = loss_in_c(loss, theta)
    if in_c is None:
        return None
    result: Tensor = _Value.apply(in_c, Layout.of({name: theta[name] for name in in_c.names}).flat(theta), batch)  # type: ignore[no-untyped-call]
    return result


class _Value(torch.autograd.Function):
    """A loss in C, whose gradient comes with it."""

    @staticmethod
    def forward(ctx: Any, loss: LossInC, theta: Tensor, batch: Batch) -> Tensor:
        ctx.gradient, losses = loss.gradient(theta.detach(), batch, {})
        return losses

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, pull: Tensor) -> tuple[None, Tensor, None]:
        return None, pull[:, None] * ctx.gradient, None


def _fits(layout: Layout) -> bool:
    return sum(layout.sizes) <= MOST and all(max(_matrix(shape)) <= WIDEST for _, shape in layout.shapes)


def _matrix(shape: tuple[int, ...]) -> tuple[int, int]:
    """Rows and columns of a parameter; what has not two axes has no matrices at its sides, and may be long."""
    return (shape[0], shape[1]) if len(shape) == 2 else (1, 1)


@functools.cache
def compiled(march: str = "native") -> ctypes.CDLL | None:
    """The functions of `step.c` by the instructions of a CPU; None where there is no compiler for it."""
    result = load(Path(__file__).with_name("step.c"), "step", "step_back", march=march)
    if result is not None:
        counts, pointer = [ctypes.c_int] * 3, ctypes.c_void_p
        result.step.argtypes = [*counts, *[pointer] * 7]
        result.step_back.argtypes = [*counts, *[pointer] * 9]
    return result


def _first_state(theta: Params) -> Params:
    """Adam's moments [T, P], and the products of its betas [T, 2]."""
    flat = theta["theta"]
    return {"m": torch.zeros_like(flat), "v": torch.zeros_like(flat), "products": flat.new_ones(len(flat), 2)}


def _no_state(theta: Params) -> Params:
    return {}


Needed = tuple[Batch | None, Tensor]  # the batch, of order 2 alone, and the gradient


class _Step:
    """Forward and backward of one step in C."""

    def __init__(self, layout: Layout, loss: LossInC, order: int) -> None:
        self.loss, self.order = loss, order
        functions = compiled()
        assert functions is not None, "a loss in C is offered with the library alone"
        self.functions = functions
        pairs = [
            (*_matrix(shape), shape[0] > 1, shape[1] > 1) if len(shape) == 2 else (1, math.prod(shape), False, False)
            for _, shape in layout.shapes
        ]
        self.shapes = sum(layout.sizes), len(pairs), (_Shape * len(pairs))(*(_Shape(*pair) for pair in pairs))

    def needed(self, batch: Batch, grads: Tensor) -> Needed:
        """The gradient, which is small, and for its derivative the batch."""
        return (batch if self.order == 2 else None, grads)

    def forward(
        self, alpha: Params, theta: Params, state: Params, batch: Batch
    ) -> tuple[Params, Params, Tensor, Tensor]:
        flat = theta["theta"].contiguous()
        grads, losses = self.loss.gradient(flat, batch, loss_parameters(alpha))
        moved, after = torch.empty_like(flat), {key: torch.empty_like(value) for key, value in state.items()}
        tree = _alpha(alpha)
        self.functions.step(
            flat.shape[0], *self.shapes, ctypes.byref(tree), flat.data_ptr(), grads.data_ptr(), _state(state),
            moved.data_ptr(), _state(after),
        )  # fmt: skip
        return {"theta": moved}, after, losses, grads

    def backward(
        self, alpha: Params, theta: Params, state: Params, needed: Needed, pull_theta: Params, pull_state: Params
    ) -> tuple[Params, Params, Params]:
        batch, grads = needed
        pull, tree = pull_theta["theta"], _alpha(alpha)
        by_grads, by_state = torch.empty_like(grads), {key: torch.empty_like(value) for key, value in state.items()}
        sizes = {key: alpha[key].shape[-1] for key in ("adam", "matrices") if key in alpha} | {"rate": grads.shape[1]}
        pulled: Params = {key: grads.new_empty(grads.shape[0], size) for key, size in sizes.items()}
        self.functions.step_back(
            grads.shape[0], *self.shapes, ctypes.byref(tree), grads.data_ptr(),
            _state(state), pull.data_ptr(), _state(pull_state), by_grads.data_ptr(), _state(by_state),
            _reference(_Pulled, pulled),
        )  # fmt: skip
        if batch is not None:
            learned = loss_parameters(alpha)
            product, by_learned = self.loss.product(theta["theta"].contiguous(), batch, learned, by_grads)
            pull = pull + product
            pulled |= {f"loss.{key}": value for key, value in by_learned.items()}
        by_alpha = {key: pulled[key].sum_to_size(alpha[key].shape) for key in pulled}
        return {"theta": pull}, by_state, by_alpha


def _state(state: Params) -> object:
    """Where the moments and the products lie; nowhere without an Adam."""
    return _reference(_State, state)


def _reference(kind: type[ctypes.Structure], tensors: Params) -> object:
    """A structure of pointers to dense tensors, null where there is none of that name."""
    return ctypes.byref(kind(**{key: value.data_ptr() for key, value in tensors.items()}))


def _alpha(alpha: Params) -> _Alpha:
    """Where one step's hyperparameters lie: [T or 1, n], of which the last axis is dense, unless it is 1."""
    pointers, strides = [], []
    for key in ("rate", "adam", "matrices"):
        value = alpha.get(key)
        pointers.append(None if value is None else value.data_ptr())
        strides.append(0 if value is None or value.shape[0] == 1 else value.stride(0))
    return _Alpha(*pointers, strides[0], int(alpha["rate"].shape[-1] > 1), *strides[1:])
