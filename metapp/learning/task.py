"""Tasks, the tensors that they must hold, and flat trees of parameters and samples."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import torch
from torch import Tensor

Params = dict[str, Tensor]  # parameters by name
Batch = dict[str, Tensor]  # samples by name


class Task(NamedTuple):
    """A thing to reproduce: a material, a texture, a map, a scene.

    Attributes:
        name: in tables and files.
        data: observations by name, without a task axis; `App.tensors` of the application lists them.
        group: of tasks that show one thing, such as photos of a material, which no split parts; "" for its own.
        note: the part of its file that it shows, and the size; "" if that is all of it, as it is.

    >>> Task("gold", {"target": torch.zeros(3, 8)}).name
    'gold'
    """

    name: str
    data: dict[str, Tensor]
    group: str = ""
    note: str = ""


class LeastSquares(NamedTuple):
    """Weighted least squares near a loss, in a parameter W [T, C, F] that the network is linear in.

    Minimising sum_n weights_n |residual_n - change features_n|^2 over the change of W lowers the loss.

    Attributes:
        name: of the parameter.
        features: factors of W, [T, F, N].
        residual: target minus output, before the nonlinearity after the linear layer, [T, C, N].
        weights: of the samples, [T, N], above 0.
        losses: of each task, [T].
        prior: precision of W around its initialisation, added to the rule's penalties, [T, C, F]; None: 0.
        axes: orthonormal axes of the outputs, as columns [C, C], along which the rule's penalties and `prior` hold;
            None: those of the outputs themselves.
    """

    name: str
    features: Tensor
    residual: Tensor
    weights: Tensor
    losses: Tensor
    prior: Tensor | None = None
    axes: Tensor | None = None


class TensorSpec(NamedTuple):
    """The form of a tensor of a task.

    Attributes:
        shape: sizes; a letter is any size, equal wherever it stands in a task.
        kind: "float" (16, 32 or 64 bits) or "uint8".
        low, high: least and greatest value.
        optional: whether a task may lack it.

    >>> spec = TensorSpec((3, "N"), low=0.0)
    >>> problems_of(Task("gold", {"target": torch.zeros(2, 8)}), {"target": spec})
    ["tensor 'target' is float32 [2, 8], expected float [3, N]"]
    """

    shape: tuple[int | str, ...]
    kind: Literal["float", "uint8"] = "float"
    low: float = -math.inf
    high: float = math.inf
    optional: bool = False


KIND_TENSOR = "kind"  # tensor of tasks of any application: the number of its kind; training draws as many of each kind
RESERVED_TENSORS = {KIND_TENSOR: TensorSpec((1,), "uint8", optional=True)}
_KINDS = {"float": (torch.float16, torch.float32, torch.float64), "uint8": (torch.uint8,)}


def problems_of(task: Task, specs: Mapping[str, TensorSpec]) -> list[str]:
    """The errors in a task's tensors, a line each: found, expected.

    Args:
        task: from any file.
        specs: of its tensors by name; further tensors need only be finite.

    >>> problems_of(Task("gold", {}), {"target": TensorSpec((3, "N"))})
    ["tensor 'target' is missing, expected float [3, N]"]
    """
    missing = [key for key, spec in specs.items() if key not in task.data and not spec.optional]
    problems = [f"tensor '{key}' is missing, expected {_expected(specs[key])}" for key in missing]
    sizes: dict[str, int] = {}
    for key, tensor in task.data.items():
        spec = specs.get(key) or RESERVED_TENSORS.get(key)
        if tensor.is_floating_point() and tensor.dtype not in _KINDS["float"]:
            problems.append(f"tensor '{key}' is {_found(tensor)}, expected floats of 16, 32 or 64 bits")
        elif spec and (tensor.dtype not in _KINDS[spec.kind] or not _has_shape(tensor, spec.shape, sizes)):
            problems.append(f"tensor '{key}' is {_found(tensor)}, expected {_expected(spec)}")
        elif not bool(torch.isfinite(tensor).all()):
            problems.append(f"tensor '{key}' holds NaN or infinite values, expected finite ones")
        elif spec and not spec.low <= float(tensor.min()) <= float(tensor.max()) <= spec.high:
            range_of = f"{float(tensor.min()):g} to {float(tensor.max()):g}"
            problems.append(f"tensor '{key}' holds {range_of}, expected {spec.low:g} to {spec.high:g}")
    return problems


def _has_shape(tensor: Tensor, shape: tuple[int | str, ...], sizes: dict[str, int]) -> bool:
    """Whether a shape fits the sizes of letters so far; sizes of further letters are added."""
    if tensor.ndim != len(shape) or tensor.numel() == 0:
        return False
    pairs = zip(tensor.shape, shape, strict=True)
    return all(
        size == (sizes.setdefault(letter, size) if isinstance(letter, str) else letter) for size, letter in pairs
    )


def _found(tensor: Tensor) -> str:
    return f"{str(tensor.dtype).removeprefix('torch.')} {list(tensor.shape)}"


def _expected(spec: TensorSpec) -> str:
    return f"{spec.kind} [{', '.join(map(str, spec.shape))}]"


@dataclass(frozen=True)
class Tasks:
    """Stacked tasks, and the rows of a view of them.

    Attributes:
        names: of all stacked tasks, M of them.
        data: tensors [M, ...], made by the application's `prepare`.
        rows: indices [T] of the tasks of this view, on the data's device.
        groups: of the stacked tasks; () if each is its own.

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
        """A view of the tasks at these positions of this view; nothing is copied."""
        return replace(self, rows=self.rows[torch.as_tensor(rows, device=self.rows.device)])

    @functools.cached_property  # reading rows waits for a GPU
    def selected_names(self) -> tuple[str, ...]:
        """The names of the tasks in this view, in order."""
        return tuple(self.names[row] for row in self.rows.tolist())

    def kind_weights(self) -> Tensor:
        """The weights of the tasks of this view, [T], equal in sum for all kinds; 1 without kinds."""
        if KIND_TENSOR not in self.data:
            return torch.ones(len(self), device=self.rows.device)
        kinds = self.data[KIND_TENSOR][self.rows, 0].long()
        return 1 / kinds.bincount()[kinds]

    def make_variants(self, data: dict[str, Tensor]) -> Tasks:
        """Augmented tasks of tensors [T, ...], one of each task of this view, in order."""
        names = tuple(f"variant of {name}" for name in self.selected_names)
        return Tasks(names, data, torch.arange(len(names), device=self.rows.device))
