"""Tasks, the tensors that they must hold, and flat trees of parameters and samples.

This is the vocabulary that all of learning shares. A task may come from anywhere; which files it is read from, and
what its tensors mean, is known elsewhere.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import torch
from torch import Tensor

Params = dict[str, Tensor]  # parameters of networks or rules by name
Batch = dict[str, Tensor]  # samples by name


class Task(NamedTuple):
    """A thing to reproduce: a material, a texture, a map, a scene.

    Attributes:
        name: the name in tables and files.
        data: observations by name, without a task axis; `App.tensors` of the application lists them.
        group: the name of a group of tasks that show one thing, such as several photos of a material; training and
            validation tasks never share a group. "" if no other task shows the thing.
        note: which part of its file the task shows, and at which size; "" if it shows the whole file as it is.

    >>> Task("gold", {"target": torch.zeros(3, 8)}).name
    'gold'
    """

    name: str
    data: dict[str, Tensor]
    group: str = ""
    note: str = ""


def select_prefixed(params: Params, prefix: str) -> Params:
    """Select the parameters whose names begin with a prefix, under their names without it.

    >>> select_prefixed({"encoder.w": torch.ones(1), "decoder.w": torch.zeros(1)}, "encoder.")
    {'w': tensor([1.])}
    """
    return {name.removeprefix(prefix): value for name, value in params.items() if name.startswith(prefix)}


def add_task_axis(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return tensors, such as the parameters of one fit or the data of one task, with a task axis of one entry.

    >>> add_task_axis({"target": torch.zeros(3, 8)})["target"].shape
    torch.Size([1, 3, 8])
    """
    return {name: tensor[None] for name, tensor in tensors.items()}


class LeastSquares(NamedTuple):
    """A weighted least-squares problem near a loss, in a parameter W [T, C, F] that the network is linear in.

    Minimising sum_n weights_n |residual_n - change features_n|^2 over a change of W lowers the loss. T is tasks, C
    outputs, F features and N samples.

    Attributes:
        name: the name of the parameter W.
        features: the factors of W, [T, F, N].
        residual: target minus output, before the nonlinearity that follows the linear layer, [T, C, N].
        weights: the weight of each sample, [T, N], above 0.
        losses: the loss of each task, [T].
        prior: the precision of W around its initialisation, [T, C, F], which is added to the rule's penalties; None for
            0.
        axes: orthonormal axes of the output space, as columns [C, C], along which the rule's penalties and `prior`
            hold; None for the outputs themselves.
    """

    name: str
    features: Tensor
    residual: Tensor
    weights: Tensor
    losses: Tensor
    prior: Tensor | None = None
    axes: Tensor | None = None


class TensorSpec(NamedTuple):
    """The form that a tensor of a task must have, or a parameter of a fit that its task determines.

    Attributes:
        shape: the size of each axis; a letter stands for any size, the same wherever the letter appears in a task.
        kind: "float" (16, 32 or 64 bits) or "uint8".
        low, high: the least and the greatest value.
        optional: whether a task or a fit may lack the tensor.

    >>> spec = TensorSpec((3, "N"), low=0.0)
    >>> problems_of(Task("gold", {"target": torch.zeros(2, 8)}), {"target": spec})
    ["tensor 'target' is float32 [2, 8], expected float [3, N]"]
    """

    shape: tuple[int | str, ...]
    kind: Literal["float", "uint8"] = "float"
    low: float = -math.inf
    high: float = math.inf
    optional: bool = False


# the name of a tensor that tasks of any application may have: the number of the task's kind; training draws as many
# tasks of each kind on average
KIND_TENSOR = "kind"
RESERVED_TENSORS = {KIND_TENSOR: TensorSpec((1,), "uint8", optional=True)}
_KINDS = {"float": (torch.float16, torch.float32, torch.float64), "uint8": (torch.uint8,)}


def problems_of(task: Task, specs: Mapping[str, TensorSpec]) -> list[str]:
    """List the errors in a task's tensors, one line each: what was found, and what is expected.

    Args:
        task: a task from any source.
        specs: the form of each tensor by name; tensors without a form need only be finite.

    >>> problems_of(Task("gold", {}), {"target": TensorSpec((3, "N"))})
    ["tensor 'target' is missing, expected float [3, N]"]
    """
    missing = [key for key, spec in specs.items() if key not in task.data and not spec.optional]
    problems = [f"tensor '{key}' is missing, expected {_describe_spec(specs[key])}" for key in missing]
    sizes: dict[str, int] = {}
    for key, tensor in task.data.items():
        spec = specs.get(key) or RESERVED_TENSORS.get(key)
        if tensor.is_floating_point() and tensor.dtype not in _KINDS["float"]:
            problems.append(f"tensor '{key}' is {_describe_tensor(tensor)}, expected floats of 16, 32 or 64 bits")
        elif spec and (tensor.dtype not in _KINDS[spec.kind] or not _has_shape(tensor, spec.shape, sizes)):
            problems.append(f"tensor '{key}' is {_describe_tensor(tensor)}, expected {_describe_spec(spec)}")
        elif not bool(torch.isfinite(tensor).all()):
            problems.append(f"tensor '{key}' holds NaN or infinite values, expected finite ones")
        elif spec and not spec.low <= float(tensor.min()) <= float(tensor.max()) <= spec.high:
            value_range = f"{float(tensor.min()):g} to {float(tensor.max()):g}"
            problems.append(f"tensor '{key}' holds {value_range}, expected {spec.low:g} to {spec.high:g}")
    return problems


def _has_shape(tensor: Tensor, shape: tuple[int | str, ...], sizes: dict[str, int]) -> bool:
    """Return whether a tensor has the shape of a specification.

    Args:
        tensor: the tensor.
        shape: the specified size of each axis, a number or a letter.
        sizes: the sizes that letters have so far; letters that are met for the first time are added.
    """
    if tensor.ndim != len(shape) or tensor.numel() == 0:
        return False
    pairs = zip(tensor.shape, shape, strict=True)
    return all(
        size == (sizes.setdefault(letter, size) if isinstance(letter, str) else letter) for size, letter in pairs
    )


def _describe_tensor(tensor: Tensor) -> str:
    """Describe a tensor by its type and shape, such as "float32 [2, 8]"."""
    return f"{str(tensor.dtype).removeprefix('torch.')} {list(tensor.shape)}"


def _describe_spec(spec: TensorSpec) -> str:
    """Describe a specification by its kind and shape, such as "float [3, N]"."""
    return f"{spec.kind} [{', '.join(map(str, spec.shape))}]"


@dataclass(frozen=True)
class Tasks:
    """Stacked tasks, and the rows that a view of them selects.

    Attributes:
        names: the names of all M stacked tasks.
        data: tensors [M, ...] that the application's `prepare` made, by name.
        rows: indices [T] of the tasks of this view, on the device of the data.
        groups: the group of each of the M tasks; () if each task is a group by itself.

    >>> tasks = Tasks(("gold", "chalk", "felt"), {}, torch.arange(3))
    >>> tasks.select([2, 0]).selected_names
    ('felt', 'gold')
    """

    names: tuple[str, ...]
    data: dict[str, Tensor]
    rows: Tensor
    groups: tuple[str, ...] = ()

    def __len__(self) -> int:
        return self.rows.shape[0]

    def select(self, rows: Tensor | Sequence[int]) -> Tasks:
        """Return a view of the tasks at some positions of this view, without copying tensors."""
        return replace(self, rows=self.rows[torch.as_tensor(rows, device=self.rows.device)])

    def gather(self, names: Sequence[str]) -> Batch:
        """Return the tensors of some names of the tasks of this view, [T, ...]; of a single stacked task no copies."""
        if len(self.names) == 1 and len(self) == 1:
            return {name: self.data[name] for name in names}  # the photographs of one task may have gigabytes
        return {name: self.data[name][self.rows] for name in names}

    @functools.cached_property  # reading rows waits for a GPU
    def selected_names(self) -> tuple[str, ...]:
        """The names of the tasks in this view, in order."""
        return tuple(self.names[row] for row in self.rows.tolist())

    def kind_weights(self) -> Tensor:
        """Return a weight for each task of this view, [T], by which the tasks of each kind sum to 1.

        Without kinds all weights are 1.
        """
        if KIND_TENSOR not in self.data:
            return torch.ones(len(self), device=self.rows.device)
        kinds = self.data[KIND_TENSOR][self.rows, 0].long()
        return 1 / kinds.bincount()[kinds]

    def make_variants(self, data: dict[str, Tensor]) -> Tasks:
        """Return augmented tasks with tensors [T, ...], one for each task of this view, in order."""
        names = tuple(f"variant of {name}" for name in self.selected_names)
        return Tasks(names, data, torch.arange(len(names), device=self.rows.device))
