"""Outer steps of Meta-SGD on the NBRDF network, with their gradient in C (`meta_sgd.c`).

The gradient of :func:`metapp.learning.learn.after_learning` in torch is the reference, from which results differ by
rounding. An outer step takes a third of the time.
"""

from __future__ import annotations

import ctypes
import functools
import math
from pathlib import Path

import torch
from torch import Tensor

from metapp.extensions.native import nbrdf
from metapp.extensions.native.compiler import load_library
from metapp.learning.adjoint import AnyBatch, Loss, Steps, UpdateRule, torch_steps
from metapp.learning.learn import LossAfterLearning
from metapp.learning.rules import LearnedRule
from metapp.learning.rules.descent import AdamStep
from metapp.learning.rules.parts import Rates
from metapp.learning.task import Params

PHI_SHAPES = {f"theta.{name}": shape for name, shape in nbrdf.NBRDF_PARAMETER_SHAPES.items()}
PHI_SHAPES |= {f"alpha.rate.{name}": (1, *shape) for name, shape in nbrdf.NBRDF_PARAMETER_SHAPES.items()}
PHI_SIZES = [math.prod(shape) for shape in PHI_SHAPES.values()]
WEIGHTS = sum(PHI_SIZES) // 2
FIRST_NAME = next(iter(PHI_SHAPES))
BETAS, MOMENTS, PRODUCTS = ("beta1", "beta2"), ("m", "v"), ("product1", "product2")  # names of Adam's tensors


class _Fits(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("gradient", "product")),
        *((name, ctypes.c_int) for name in ("weights", "inner_steps", "tasks", "samples", "order")),
        *(("clip", ctypes.c_float), ("smoothing", ctypes.c_void_p)),
    ]


@functools.cache
def load_meta_sgd_library(march: str = "native") -> ctypes.CDLL | None:
    """Load the function of `meta_sgd.c`, compiled if need be.

    Args:
        march: the instruction set, a name that the compiler knows; native is this CPU's.

    Returns:
        The library; None if there is no compiler for these instructions.
    """
    library = load_library(Path(__file__).with_name("meta_sgd.c"), "outer_gradient", march=march)
    if library is not None:
        library.outer_gradient.argtypes = [ctypes.c_void_p] * 7
    return library


def make_outer_steps(rule: UpdateRule, loss: Loss, phi: Params) -> Steps | None:
    """Make the outer steps of a training of Meta-SGD on an NBRDF network.

    Args:
        rule: the rule of the outer loop.
        loss: the outer loss.
        phi: a flat tree of phi, whose names and shapes count.

    Returns:
        The steps; None if the gradient in C is of another loss, or if there is no compiler.
    """
    if not isinstance(loss, LossAfterLearning) or not has_c_form(rule, loss, phi) or load_meta_sgd_library() is None:
        return None

    @torch.no_grad()
    def step(alpha: Params, phi: Params, state: Params, batch: AnyBatch) -> tuple[Params, Params, Tensor, Params]:
        flat_phi = _flatten(phi)
        gradient, losses = outer_gradient(loss, flat_phi, batch)
        # the rule moves all weights as one tensor, as a step of 24 small tensors takes 1 ms
        flat_alpha = {name: alpha[name] for name in BETAS} | {"rate.phi": alpha[f"rate.{FIRST_NAME}"]}
        flat_state = {name: state[name] for name in PRODUCTS}
        flat_state |= {f"{moment}.phi": _flatten(state, f"{moment}.") for moment in MOMENTS}
        moved, moved_state = rule.step(flat_alpha, {"phi": flat_phi}, {"phi": gradient}, flat_state)
        new_state = {name: moved_state[name] for name in PRODUCTS}
        for moment in MOMENTS:
            new_state |= _unflatten(moved_state[f"{moment}.phi"], f"{moment}.")
        return _unflatten(moved["phi"]), new_state, losses, _unflatten(gradient)

    return torch_steps(rule, loss, phi, 1)._replace(step=step)


def has_c_form(rule: UpdateRule, loss: LossAfterLearning, phi: Params) -> bool:
    """Return whether `meta_sgd.c` computes the gradient of an outer loss, of tensors in float32 on the CPU.

    The rule of the outer loop must be an Adam of one rate.
    """
    learned_rule = getattr(loss.rule, "__self__", None)
    is_meta_sgd = isinstance(learned_rule, LearnedRule) and learned_rule.parts == (Rates("signed"),)
    if not is_meta_sgd or not loss.shared or loss.prediction or phi.keys() != PHI_SHAPES.keys():
        return False
    first_rate = rule.alpha.get(f"rate.{FIRST_NAME}")
    if not isinstance(rule.step, AdamStep) or first_rate is None:
        return False
    if not all(torch.equal(rule.alpha[f"rate.{name}"], first_rate) for name in PHI_SHAPES):
        return False
    theta = {name: phi[f"theta.{name}"][None] for name in nbrdf.NBRDF_PARAMETER_SHAPES}
    has_float_rates = all(phi[name].dtype == torch.float32 for name in PHI_SHAPES)
    return has_float_rates and all(nbrdf.has_c_loss(of, theta) for of in (loss.inner_loss, loss.outer_loss))


def outer_gradient(loss: LossAfterLearning, flat_phi: Tensor, batch: AnyBatch) -> tuple[Tensor, Tensor]:
    """Return the gradient of the mean outer loss in phi, [2 x 675], and the loss of each task, [T].

    Args:
        loss: the outer loss, which has a form in C.
        flat_phi: the tensors of phi side by side, [2 x 675].
        batch: the batches that the outer loss draws.
    """
    inner, outer, _ = batch
    where, target = (torch.stack([part[name] for part in (*inner, outer)]).contiguous() for name in ("where", "target"))
    tasks, samples = where.shape[1], where.shape[3]
    loss_library, library = nbrdf.load_nbrdf_library(), load_meta_sgd_library()
    assert loss_library is not None
    assert library is not None
    smoothing = loss.inner_loss.smoothing
    log_smoothing = torch.tensor(math.log(smoothing or 1.0))
    fits = _Fits(
        ctypes.cast(loss_library.nbrdf_gradient, ctypes.c_void_p),
        ctypes.cast(loss_library.nbrdf_product, ctypes.c_void_p),
        *(WEIGHTS, loss.steps, tasks, samples, loss.order, loss.clip),
        log_smoothing.data_ptr() if smoothing else None,
    )
    room = torch.empty(loss.steps + 1, 2 * WEIGHTS)
    gradient, losses = torch.zeros_like(flat_phi), torch.empty(tasks)
    tensors = (flat_phi, where, target, room, gradient, losses)
    library.outer_gradient(ctypes.byref(fits), *(tensor.data_ptr() for tensor in tensors))
    return gradient, losses


def _flatten(params: Params, prefix: str = "") -> Tensor:
    """Return the tensors of phi, or of one of Adam's moments, side by side in a new tensor [2 x 675]."""
    return torch.cat([params[prefix + name].flatten() for name in PHI_SHAPES])


def _unflatten(flat: Tensor, prefix: str = "") -> Params:
    """Return the tensors that lie side by side in a tensor [2 x 675], as views of it; see :func:`_flatten`."""
    parts = zip(PHI_SHAPES.items(), flat.split(PHI_SIZES), strict=True)
    return {prefix + name: part.view(shape) for (name, shape), part in parts}
