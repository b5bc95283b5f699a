"""The loss of the NBRDF network in C (`nbrdf.c`): `Brdf.loss` and its derivatives, for flat parameters [T, 675]."""

from __future__ import annotations

import ctypes
import functools
from pathlib import Path

import torch
from torch import Tensor

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.brdf_network import parameter_shapes
from metapp.apps.brdf.nbrdf_network import NBRDF_NETWORK
from metapp.extensions.native.compiler import load_library
from metapp.learning.adjoint import Loss
from metapp.learning.task import Batch, Params

NBRDF_PARAMETER_SHAPES = parameter_shapes(NBRDF_NETWORK)


def has_c_loss(loss: Loss, theta: Params) -> bool:
    """Tell whether a loss is `Brdf.loss` of parameters of this network, float32 on the CPU, and there is a compiler."""
    same = {key: tuple(value.shape[1:]) for key, value in theta.items()} == NBRDF_PARAMETER_SHAPES
    plain = all(value.dtype == torch.float32 and value.device.type == "cpu" for value in theta.values())
    if not same or not plain or type(loss).gradient is not Loss.gradient:
        return False
    # a subclass with a loss of its own gets steps by torch
    return getattr(loss.value, "__func__", loss.value) is Brdf.loss and load_nbrdf_library() is not None


@functools.cache
def load_nbrdf_library(march: str = "native") -> ctypes.CDLL | None:
    """The functions of `nbrdf.c` by the instructions of a CPU; None if there is no compiler for it."""
    result = load_library(
        Path(__file__).with_name("nbrdf.c"), "nbrdf_gradient", "nbrdf_product", "nbrdf_lanes", march=march
    )
    if result is not None:
        count, pointer = ctypes.c_int, ctypes.c_void_p
        read = (count, count, pointer, pointer, pointer, pointer, count, pointer, count)
        result.nbrdf_gradient.argtypes = [*read, *[pointer] * 2]
        result.nbrdf_product.argtypes = [*read, *[pointer] * 4]
    return result


def loss_gradient(theta: Tensor, batch: Batch, learned: Params) -> tuple[Tensor, Tensor]:
    """Gradient [T, 675] and loss [T]."""
    result, losses = torch.empty_like(theta), theta.new_empty(theta.shape[0])
    dense, functions = _dense(theta, batch), load_nbrdf_library()
    assert functions is not None
    functions.nbrdf_gradient(*_read(dense, learned), result.data_ptr(), losses.data_ptr())
    return result, losses


def gradient_product(theta: Tensor, batch: Batch, learned: Params, along: Tensor) -> tuple[Tensor, Params]:
    """Derivatives of the sum of gradient * along in theta [T, 675] and in the learned parameters."""
    dense, result, along = _dense(theta, batch), torch.empty_like(theta), along.contiguous()
    pulled = {key: theta.new_empty(theta.shape[0], *value.shape[1:]) for key, value in learned.items()}
    pulls = [pulled[key].data_ptr() if key in pulled else None for key in ("smoothing", "weights")]
    functions = load_nbrdf_library()
    assert functions is not None
    functions.nbrdf_product(*_read(dense, learned), along.data_ptr(), result.data_ptr(), *pulls)
    return result, pulled


def _dense(theta: Tensor, batch: Batch) -> list[Tensor]:
    """theta, where and target without gaps."""
    where, target = batch["where"], batch["target"]
    assert where.shape[0] == target.shape[0] == theta.shape[0], "a batch has as many tasks as theta"
    return [theta.contiguous(), where.float().contiguous(), target.float().contiguous()]


def _read(dense: list[Tensor], learned: Params) -> list[int | None]:
    """The arguments of both functions, in their order; `dense` and `learned` must live until they have."""
    tasks, _, samples = dense[1].shape
    arguments: list[int | None] = [tasks, samples, *(tensor.data_ptr() for tensor in dense)]
    for key in ("smoothing", "weights"):
        value = learned.get(key)
        stride = 0 if value is None or value.shape[0] == 1 else value.stride(0)
        arguments += [None if value is None else value.data_ptr(), stride]
    return arguments
