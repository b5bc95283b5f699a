"""The outer loop of Meta-SGD on the NBRDF network in C (`meta_sgd.c`), many outer steps at a call.

The loop in torch, :func:`metapp.learning.learn.descend` of :func:`metapp.learning.learn.after_learning`, is the
reference, from which results differ by rounding. Random numbers are drawn here, by the calls of torch's generator that
the loop in torch makes, so that either loop continues a training of the other.
"""

from __future__ import annotations

import ctypes
import functools
import math
from collections.abc import Iterator
from pathlib import Path

import torch
from torch import Generator, Tensor

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.held_out_judge import HeldOutJudge
from metapp.apps.brdf.nbrdf_network import Nbrdf
from metapp.apps.brdf.sample_sight import SampleSight
from metapp.extensions.native import nbrdf
from metapp.extensions.native.compiler import load_library
from metapp.learning.learn import DescentState
from metapp.learning.recipe import MetaTraining, OuterLoop
from metapp.learning.rules import outer_adam
from metapp.learning.rules.parts import SignedRates
from metapp.learning.task import KIND_TENSOR, Params, Tasks
from metapp.paradigms.meta import Meta
from metapp.paradigms.paradigm import Paradigm

MAX_BLOCK_STEPS = 250  # outer steps of a call, at most: their numbers of samples take 11 MB for one task a step

PHI_NAMES = [f"{part}{name}" for part in ("theta.", "alpha.rate.") for name in nbrdf.NBRDF_PARAMETER_SHAPES]
WEIGHTS = sum(math.prod(shape) for shape in nbrdf.NBRDF_PARAMETER_SHAPES.values())


class _Training(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("gradient", "product")),
        *((name, ctypes.c_int) for name in ("weights", "inner_steps", "tasks", "samples", "order")),
        *((name, ctypes.c_float) for name in ("clip", "weight_decay")),
        *((name, ctypes.c_void_p) for name in ("smoothing", "where", "target")),
        *((name, ctypes.c_int64) for name in ("where_by_task", "target_by_task")),
    ]


_STATE_NAMES = ("phi", "m", "v", "products")


class _State(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in _STATE_NAMES]


@functools.cache
def load_meta_sgd_library(march: str = "native") -> ctypes.CDLL | None:
    """Load the function of `meta_sgd.c`, compiled if need be.

    Args:
        march: the instruction set, a name that the compiler knows; native is this CPU's.

    Returns:
        The library; None if there is no compiler for these instructions.
    """
    library = load_library(Path(__file__).with_name("meta_sgd.c"), "outer_steps", march=march)
    if library is not None:
        pointer = ctypes.c_void_p
        library.outer_steps.argtypes = [pointer, ctypes.c_int, *[pointer] * 6]
    return library


def descend_in_c(
    paradigm: Paradigm,
    outer_loop: OuterLoop,
    params: Params,
    tasks: Tasks,
    rng: Generator,
    since: DescentState | None = None,
) -> Iterator[DescentState] | None:
    """Descend the outer loss in C, if the paradigm is Meta-SGD of an NBRDF network.

    See :class:`metapp.registry.DescendOuterLoss` for the arguments.

    Returns:
        The states of the descent; None if the loop in C computes another loss, or if there is no compiler.
    """
    if not isinstance(paradigm, Meta) or not isinstance(outer_loop, MetaTraining):
        return None
    if not _has_c_form(paradigm, outer_loop, params, tasks):
        return None
    loss_library, library = nbrdf.load_nbrdf_library(), load_meta_sgd_library()
    if loss_library is None or library is None:
        return None
    return _descend(paradigm, outer_loop, params, tasks, rng, since, loss_library, library)


def _has_c_form(paradigm: Meta, outer_loop: MetaTraining, params: Params, tasks: Tasks) -> bool:
    """Return whether the outer loss is what `meta_sgd.c` computes, of tensors in float32 on the CPU."""
    app = paradigm.app
    overridden = ("sample", "outer_sample", "outer_loss", "loss", "coarsen")  # by a subclass, which torch alone knows
    if not isinstance(app, Brdf) or any(getattr(type(app), name) is not getattr(Brdf, name) for name in overridden):
        return False
    if type(app.sight) is not SampleSight or type(app.judge) is not HeldOutJudge:
        return False
    if type(app.network) is not Nbrdf or [type(part) for part in paradigm.learned_rule.parts] != [SignedRates]:
        return False
    if outer_loop.augment or list(outer_loop.rates) != [""] or KIND_TENSOR in tasks.data:
        return False
    tensors = [*params.values(), *(tasks.data[key] for key in ("where", "target"))]
    is_cpu_float32 = all(value.dtype == torch.float32 and value.device.type == "cpu" for value in tensors)
    return is_cpu_float32 and set(params) == set(PHI_NAMES)


def _descend(
    paradigm: Meta,
    outer_loop: MetaTraining,
    params: Params,
    tasks: Tasks,
    rng: Generator,
    since: DescentState | None,
    loss_library: ctypes.CDLL,
    library: ctypes.CDLL,
) -> Iterator[DescentState]:
    """Take outer steps in C, a block at a call, and yield the state before the first block and after each block."""
    count, samples, inner_steps = min(outer_loop.tasks, len(tasks)), paradigm.recipe.samples, paradigm.steps
    where, target = (_make_samples_dense(tasks.data[key]) for key in ("where", "target"))
    log_smoothing = torch.tensor(math.log(outer_loop.smoothing or 1.0))
    settings = _Training(
        ctypes.cast(loss_library.nbrdf_gradient, ctypes.c_void_p),
        ctypes.cast(loss_library.nbrdf_product, ctypes.c_void_p),
        *(WEIGHTS, inner_steps, count, samples, outer_loop.order, outer_loop.clip, outer_loop.weight_decay),
        *(log_smoothing.data_ptr() if outer_loop.smoothing else None, where.data_ptr(), target.data_ptr()),
        *(where.stride(0), target.stride(0)),
    )
    rule = outer_adam(outer_loop, params)
    latest = since or DescentState(0, {key: value.detach() for key, value in params.items()}, rule.init(params))
    yield latest
    state = {"phi": _flatten(latest.theta), "products": torch.zeros(2)}
    state |= {moment: _flatten(latest.rule_state, f"{moment}.") for moment in ("m", "v")}
    torch.stack([latest.rule_state["product1"], latest.rule_state["product2"]], out=state["products"])
    room = torch.empty(inner_steps + 1, 2 * WEIGHTS + samples * (where.shape[2] + target.shape[2]))
    rates = rule.alpha[f"rate.{PHI_NAMES[0]}"]
    while latest.step < outer_loop.steps:
        until_validation = outer_loop.validate_every - latest.step % outer_loop.validate_every
        steps = min(until_validation, outer_loop.steps - latest.step, MAX_BLOCK_STEPS)
        rows, numbers = _draw_block(tasks, rng, steps, count, (inner_steps + 1, count, samples), where.shape[1] // 2)
        losses, block_rates = torch.empty(steps, count), rates[latest.step : latest.step + steps].contiguous()
        pointers = _State(*(state[name].data_ptr() for name in _STATE_NAMES))
        taken: int = library.outer_steps(
            *(ctypes.byref(settings), steps, block_rates.data_ptr(), rows.data_ptr(), numbers.data_ptr()),
            *(ctypes.byref(pointers), room.data_ptr(), losses.data_ptr()),
        )
        names = tuple(tasks.names[row] for row in rows[:taken].flatten().tolist())
        latest = DescentState(
            latest.step + taken, _unflatten(state["phi"]), _unflatten_state(state), losses[:taken].flatten(), names
        )
        yield latest


def _make_samples_dense(values: Tensor) -> Tensor:
    """Return samples [M, N, C] such that each task's lie without gaps; tasks may share them."""
    return values if values.stride(2) == 1 and values.stride(1) == values.shape[2] else values.contiguous()


def _draw_block(
    tasks: Tasks, rng: Generator, steps: int, count: int, shape: tuple[int, int, int], half: int
) -> tuple[Tensor, Tensor]:
    """Draw the tasks and samples of outer steps as the loop in torch does, one step after the other.

    A call of `randint` draws as many calls of a part each do. The last batch of a step is of the outer loss, from the
    second half of the samples.

    Args:
        tasks: the training tasks.
        rng: the source of all random numbers.
        steps: the number of outer steps.
        count: the number of tasks of a step.
        shape: the numbers of batches of a step, of tasks, and of samples of a batch.
        half: half of the number of a task's samples.

    Returns:
        The rows of the tasks among all stacked tasks, [steps, count], and the samples, [steps, *shape], int64.
    """
    rows = torch.empty(steps, count, dtype=torch.int64)
    numbers = torch.empty(steps, *shape, dtype=torch.int64)
    for step in range(steps):
        rows[step] = torch.randperm(len(tasks), generator=rng)[:count]
        torch.randint(half, shape, generator=rng, out=numbers[step])
    numbers[:, -1] += half
    return tasks.rows[rows], numbers


def _flatten(params: Params, prefix: str = "") -> Tensor:
    """Return the tensors of phi, or of one of Adam's moments, side by side in a new tensor [2 x 675]."""
    return torch.cat([params[prefix + name].flatten() for name in PHI_NAMES])


def _unflatten(flat: Tensor, prefix: str = "") -> Params:
    """Return the tensors that lie side by side in a tensor [2 x 675], copied. See :func:`_flatten`."""
    shapes = [*nbrdf.NBRDF_PARAMETER_SHAPES.values(), *((1, *s) for s in nbrdf.NBRDF_PARAMETER_SHAPES.values())]
    parts = flat.clone().split([math.prod(shape) for shape in shapes])
    return {prefix + name: part.view(shape) for name, part, shape in zip(PHI_NAMES, parts, shapes, strict=True)}


def _unflatten_state(state: Params) -> Params:
    """Return the state of the outer Adam as :func:`metapp.learning.rules.descent.adam_state` names it."""
    product1, product2 = state["products"].clone().unbind()
    moments = _unflatten(state["m"], "m.") | _unflatten(state["v"], "v.")
    return moments | {"product1": product1, "product2": product2}
