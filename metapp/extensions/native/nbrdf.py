"""The loss of the NBRDF network in C (`nbrdf.c`): `SampleSight.loss` and its derivatives, for flat parameters [T, 675].

A step spends most of its time in this loss. The module knows the loss of the BRDF application, but no rule of learning.
"""

from __future__ import annotations

import ctypes
import functools
from pathlib import Path

import torch
from torch import Tensor

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.brdf_network import parameter_shapes
from metapp.apps.brdf.nbrdf_network import NBRDF_NETWORK
from metapp.apps.brdf.sample_sight import SampleSight
from metapp.extensions.native.compiler import load_library
from metapp.learning.adjoint import Loss
from metapp.learning.task import Batch, Params

NBRDF_PARAMETER_SHAPES = parameter_shapes(NBRDF_NETWORK)


def has_c_loss(loss: Loss, theta: Params) -> bool:
    """Return whether the loss is `SampleSight.loss` of an NBRDF in float32 on the CPU, and a compiler exists."""
    has_nbrdf_shapes = {key: tuple(value.shape[1:]) for key, value in theta.items()} == NBRDF_PARAMETER_SHAPES
    is_cpu_float32 = all(value.dtype == torch.float32 and value.device.type == "cpu" for value in theta.values())
    if not has_nbrdf_shapes or not is_cpu_float32 or type(loss).gradient is not Loss.gradient:
        return False
    # a subclass of Brdf or of its sight that overrides the loss gets steps by torch
    app = getattr(loss.value, "__self__", None)
    if not isinstance(app, Brdf) or loss.value != app.loss or type(app).loss is not Brdf.loss:
        return False
    return type(app.sight).loss is SampleSight.loss and load_nbrdf_library() is not None


@functools.cache
def load_nbrdf_library(march: str = "native") -> ctypes.CDLL | None:
    """Load the functions of `nbrdf.c`, compiled if need be.

    Args:
        march: the instruction set, a name that the compiler knows; native is this CPU's.

    Returns:
        The library; None if there is no compiler for these instructions.
    """
    library = load_library(
        Path(__file__).with_name("nbrdf.c"), "nbrdf_gradient", "nbrdf_product", "nbrdf_lanes", march=march
    )
    if library is not None:
        count, pointer = ctypes.c_int, ctypes.c_void_p
        shared_arguments = (count, count, pointer, pointer, pointer, pointer, count, pointer, count)
        library.nbrdf_gradient.argtypes = [*shared_arguments, *[pointer] * 2]
        library.nbrdf_product.argtypes = [*shared_arguments, *[pointer] * 4]
    return library


def loss_gradient(theta: Tensor, batch: Batch, loss_parameters: Params) -> tuple[Tensor, Tensor]:
    """Return the gradient of the loss, [T, 675], and the losses, [T].

    Args:
        theta: flat parameters, [T, 675].
        batch: `where` [T, 7, N] and `target` [T, 3, N], samples of T materials.
        loss_parameters: `smoothing` [T or 1] and `weights` [T or 1, 8], or none.
    """
    gradient, losses = torch.empty_like(theta), theta.new_empty(theta.shape[0])
    dense, library = _make_dense(theta, batch), load_nbrdf_library()
    assert library is not None
    library.nbrdf_gradient(*_shared_arguments(dense, loss_parameters), gradient.data_ptr(), losses.data_ptr())
    return gradient, losses


def gradient_product(theta: Tensor, batch: Batch, loss_parameters: Params, along: Tensor) -> tuple[Tensor, Params]:
    """Return the derivatives of the product of the loss's gradient and a direction.

    Args:
        theta: flat parameters, [T, 675].
        batch: `where` [T, 7, N] and `target` [T, 3, N], samples of T materials.
        loss_parameters: `smoothing` [T or 1] and `weights` [T or 1, 8], or none.
        along: the direction, [T, 675].

    Returns:
        Derivatives in theta, [T, 675], and in each learned parameter, [T, ...].
    """
    dense, product, along = _make_dense(theta, batch), torch.empty_like(theta), along.contiguous()
    pulls = {key: theta.new_empty(theta.shape[0], *value.shape[1:]) for key, value in loss_parameters.items()}
    pointers = [pulls[key].data_ptr() if key in pulls else None for key in ("smoothing", "weights")]
    library = load_nbrdf_library()
    assert library is not None
    library.nbrdf_product(*_shared_arguments(dense, loss_parameters), along.data_ptr(), product.data_ptr(), *pointers)
    return product, pulls


def _make_dense(theta: Tensor, batch: Batch) -> list[Tensor]:
    """Return theta, `where` and `target` as tensors without gaps, the samples as float32."""
    where, target = batch["where"], batch["target"]
    assert where.shape[0] == target.shape[0] == theta.shape[0], "a batch has as many tasks as theta"
    return [theta.contiguous(), where.float().contiguous(), target.float().contiguous()]


def _shared_arguments(dense: list[Tensor], loss_parameters: Params) -> list[int | None]:
    """Return the arguments that both functions of `nbrdf.c` begin with.

    They are pointers: the tensors of `dense` and `loss_parameters` must live until the call has returned.
    """
    tasks, _, samples = dense[1].shape
    arguments: list[int | None] = [tasks, samples, *(tensor.data_ptr() for tensor in dense)]
    for key in ("smoothing", "weights"):
        value = loss_parameters.get(key)
        stride = 0 if value is None or value.shape[0] == 1 else value.stride(0)
        arguments += [None if value is None else value.data_ptr(), stride]
    return arguments
