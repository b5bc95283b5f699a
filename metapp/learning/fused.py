"""Steps in C (`step.c`), for small networks whose loss an application has in C, and rules whose parts are there.

What `adjoint` does by automatic differentiation of a tensor for each parameter is the reference, from which results
differ by rounding. The descent and the adjoint recursion stay the same: a `StepPair` on the tree {"theta": [T, P]}.
"""

from __future__ import annotations

import ctypes
import functools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from metapp.learning.adjoint import Loss, StepPair, UpdateRule, learn_through
from metapp.learning.flat import FusedLoss, Layout, Packing
from metapp.learning.task import Params
from metapp.native import load

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


class Fused(NamedTuple):
    """A loss and a rule in C.

    Attributes:
        layout: of theta.
        loss: of flat parameters.
        packing: of the rule.
        gathered: the rule's hyperparameters, as `Packing.gather` gave them.
    """

    layout: Layout
    loss: FusedLoss
    packing: Packing
    gathered: Params

    def rule(self, gathered: Params) -> UpdateRule:
        """The rule on {"theta": [T, P]} with these hyperparameters."""
        alpha = self.packing.quantities(gathered)
        return UpdateRule(alpha, _first_state if "adam" in alpha else _no_state, _not_by_itself)

    def steps(self, order: int) -> StepPair:
        """One step and its vector-Jacobian product."""
        step = _Step(self.layout, self.loss, order)
        return StepPair(step.forward, step.pullback, step.kept)

    def learn_through(self, theta: Tensor, gathered: Params, batches: Sequence[Any], loss: Loss, order: int) -> Tensor:
        """`adjoint.learn_through` on theta [T, P], with given hyperparameters."""
        rule = self.rule(gathered)
        return learn_through({"theta": theta}, rule, batches, loss, order=order, steps=self.steps(order))["theta"]


def fuse(rule: UpdateRule, loss: Loss, theta: Params) -> Fused | None:
    """The same in C; None where the loss, a part of the rule, the device or the numbers' type has no such form."""
    if rule.packing is None or any(v.dtype != torch.float32 or v.device.type != "cpu" for v in theta.values()):
        return None
    in_c = loss.fused(theta)
    if in_c is None or _library() is None:
        return None
    layout = Layout.of({name: theta[name] for name in in_c.names})
    if not _fits(layout):
        return None
    gathered = rule.packing.gather(rule.alpha, layout)
    return None if gathered is None else Fused(layout, in_c, rule.packing, gathered)


def flat_value(loss: Loss, layout: Layout, theta: Tensor, batch: Any) -> Tensor:
    """A loss [T] of flat parameters, differentiable once, in C where there is such a form."""
    tree = layout.tree(theta)
    in_c = loss.fused(tree)
    if in_c is None:
        return loss.value(tree, batch, {})
    result: Tensor = _Value.apply(in_c, theta, batch)  # type: ignore[no-untyped-call]
    return result


class _Value(torch.autograd.Function):
    """A loss in C, whose gradient comes with it."""

    @staticmethod
    def forward(ctx: Any, loss: FusedLoss, theta: Tensor, batch: Any) -> Tensor:
        ctx.gradient, losses = loss.gradient(theta.detach(), batch, {})
        return losses

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, pull: Tensor) -> tuple[Any, ...]:
        return None, pull[:, None] * ctx.gradient, None


def _fits(layout: Layout) -> bool:
    return sum(layout.sizes) <= MOST and all(max(_matrix(shape)) <= WIDEST for _, shape in layout.shapes)


def _matrix(shape: tuple[int, ...]) -> tuple[int, int]:
    """Rows and columns of a parameter; what has not two axes has no matrices at its sides, and may be long."""
    return (shape[0], shape[1]) if len(shape) == 2 else (1, 1)


@functools.cache
def _library() -> ctypes.CDLL | None:
    library = load(Path(__file__).with_name("step.c"))
    if library is not None:
        counts, pointer = [ctypes.c_int] * 3, ctypes.c_void_p
        library.step.argtypes = [*counts, *[pointer] * 7]
        library.step_back.argtypes = [*counts, *[pointer] * 9]
    return library


def _first_state(theta: Params) -> Params:
    """Adam's moments [T, P], and the products of its betas [T, 2]."""
    flat = theta["theta"]
    return {"m": torch.zeros_like(flat), "v": torch.zeros_like(flat), "products": flat.new_ones(len(flat), 2)}


def _no_state(theta: Params) -> Params:
    return {}


def _not_by_itself(*_: Any) -> Any:
    raise AssertionError("a step in C has its gradient with it")


class _Step:
    """Forward and backward of one step in C."""

    def __init__(self, layout: Layout, loss: FusedLoss, order: int) -> None:
        self.loss, self.order = loss, order
        self.functions: Any = _library()
        pairs = [
            (*_matrix(shape), shape[0] > 1, shape[1] > 1) if len(shape) == 2 else (1, math.prod(shape), False, False)
            for _, shape in layout.shapes
        ]
        self.shapes = sum(layout.sizes), len(pairs), (_Shape * len(pairs))(*(_Shape(*pair) for pair in pairs))

    def kept(self, batch: Any, grads: Tensor) -> Any:
        """The gradient, which is small, and for its derivative the batch."""
        return (batch if self.order == 2 else None, grads)

    def forward(self, alpha: Params, theta: Params, state: Params, batch: Any) -> tuple[Params, Params, Tensor, Tensor]:
        flat = theta["theta"].contiguous()
        grads, losses = self.loss.gradient(flat, batch, _learned(alpha))
        moved, after = torch.empty_like(flat), {key: torch.empty_like(value) for key, value in state.items()}
        tree = _alpha(alpha)
        self.functions.step(
            flat.shape[0], *self.shapes, ctypes.byref(tree), flat.data_ptr(), grads.data_ptr(), _state(state),
            moved.data_ptr(), _state(after),
        )  # fmt: skip
        return {"theta": moved}, after, losses, grads

    def pullback(
        self, alpha: Params, theta: Params, state: Params, kept: Any, pull_theta: Params, pull_state: Params
    ) -> tuple[Params, Params, Params]:
        batch, grads = kept
        pull, tree = pull_theta["theta"], _alpha(alpha)
        by_grads, by_state = torch.empty_like(grads), {key: torch.empty_like(value) for key, value in state.items()}
        sizes = {key: alpha[key].shape[-1] for key in ("adam", "matrices") if key in alpha} | {"rate": grads.shape[1]}
        pulled: Params = {key: grads.new_empty(grads.shape[0], size) for key, size in sizes.items()}
        self.functions.step_back(
            grads.shape[0], *self.shapes, ctypes.byref(tree), grads.data_ptr(),
            _state(state), pull.data_ptr(), _state(pull_state), by_grads.data_ptr(), _state(by_state),
            _reference(_Pulled, pulled),
        )  # fmt: skip
        if self.order == 2:
            learned = _learned(alpha)
            product, by_learned = self.loss.product(theta["theta"].contiguous(), batch, learned, by_grads)
            pull = pull + product
            pulled |= {f"loss.{key}": value for key, value in by_learned.items()}
        by_alpha = {key: pulled[key].sum_to_size(alpha[key].shape) for key in pulled}
        return {"theta": pull}, by_state, by_alpha


def _learned(alpha: Params) -> Params:
    return {key[5:]: value for key, value in alpha.items() if key.startswith("loss.")}


def _state(state: Params) -> Any:
    """Where the moments and the products lie; nowhere without an Adam."""
    return _reference(_State, state)


def _reference(kind: type[ctypes.Structure], tensors: Params) -> Any:
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
