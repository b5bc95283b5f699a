"""Tasks, the tensors that they must hold, and the one tree that all parameters live in."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import torch
from torch import Generator, Tensor

Params = dict[str, Tensor]
Batch = dict[str, Tensor]


class Task(NamedTuple):
    """One thing to reproduce: a material, a texture, a map, a scene.

    Attributes:
        name: what tables and files call it.
        data: its observations, by name, without a task axis; the application says which it needs.
        group: what several tasks show, such as the material of several photos: no split parts them; "" for its own.
    """

    name: str
    data: dict[str, Tensor]
    group: str = ""


class Linear(NamedTuple):
    """Weighted least squares near a loss, in a parameter that the network is linear in, W [T, C, F].

    Minimising sum_n weights_n |residual_n - change features_n|^2 over the change of W lowers the loss.

    Attributes:
        name: the parameter's.
        features: what W multiplies, [T, F, N].
        residual: target minus output, before whatever follows the linear layer, [T, C, N].
        weights: of the samples, [T, N], above 0.
        losses: of each task, [T].
        prior: precision of W around its initialisation, added to the rule's own penalties, [T, C, F]; None: 0.
    """

    name: str
    features: Tensor
    residual: Tensor
    weights: Tensor
    losses: Tensor
    prior: Tensor | None = None


class TensorSpec(NamedTuple):
    """The form that a tensor of a task must have.

    Attributes:
        shape: sizes; a letter stands for any size, the same wherever it stands in a task.
        kind: "float" (16, 32 or 64 bits) or "uint8".
        low, high: least and greatest value.
        optional: whether a task may lack it.
    """

    shape: tuple[int | str, ...]
    kind: Literal["float", "uint8"] = "float"
    low: float = -math.inf
    high: float = math.inf
    optional: bool = False


KIND = "kind"  # tensor of tasks of any application: which of several kinds, of which training draws as many of each
RESERVED = {KIND: TensorSpec((1,), "uint8", optional=True)}
_KINDS = {"float": (torch.float16, torch.float32, torch.float64), "uint8": (torch.uint8,)}


def problems_of(task: Task, holds: Mapping[str, TensorSpec]) -> list[str]:
    """List the errors in a task's tensors, a line each: found, expected.

    Args:
        task: from a file that anybody may have written.
        holds: what it must hold, by name; further tensors need only be finite.
    """
    missing = [key for key, held in holds.items() if key not in task.data and not held.optional]
    problems = [f"tensor '{key}' is missing, expected {_said(holds[key])}" for key in missing]
    sizes: dict[str, int] = {}
    for key, tensor in task.data.items():
        held = holds.get(key) or RESERVED.get(key)
        if tensor.is_floating_point() and tensor.dtype not in _KINDS["float"]:
            problems.append(f"tensor '{key}' is {_of(tensor)}, expected floats of 16, 32 or 64 bits")
        elif held and (tensor.dtype not in _KINDS[held.kind] or not _has_shape(tensor, held.shape, sizes)):
            problems.append(f"tensor '{key}' is {_of(tensor)}, expected {_said(held)}")
        elif not bool(torch.isfinite(tensor).all()):
            problems.append(f"tensor '{key}' holds NaN or infinite values, expected finite ones")
        elif held and not held.low <= float(tensor.min()) <= float(tensor.max()) <= held.high:
            range_of = f"{float(tensor.min()):g} to {float(tensor.max()):g}"
            problems.append(f"tensor '{key}' holds {range_of}, expected {held.low:g} to {held.high:g}")
    return problems


def _has_shape(tensor: Tensor, shape: tuple[int | str, ...], sizes: dict[str, int]) -> bool:
    """Match a shape with the sizes that letters stand for so far; add those that they stand for here."""
    if tensor.ndim != len(shape) or tensor.numel() == 0:
        return False
    pairs = zip(tensor.shape, shape, strict=True)
    return all(size == (sizes.setdefault(of, size) if isinstance(of, str) else of) for size, of in pairs)


def _of(tensor: Tensor) -> str:
    return f"{str(tensor.dtype).removeprefix('torch.')} {list(tensor.shape)}"


def _said(held: TensorSpec) -> str:
    return f"{held.kind} [{', '.join(map(str, held.shape))}]"


@dataclass(frozen=True)
class Tasks:
    """Tasks side by side: every tensor has a leading task axis, of which `rows` picks some without copying.

    Attributes:
        names: the names of all stacked tasks, M of them.
        data: tensors [M, ...]; the application's `prepare` made them.
        rows: indices [T] of the tasks that this view holds, on the data's device.
        groups: of the stacked tasks; () where each is its own.
    """

    names: tuple[str, ...]
    data: dict[str, Tensor]
    rows: Tensor
    groups: tuple[str, ...] = ()

    def __len__(self) -> int:
        return self.rows.shape[0]

    def select(self, rows: Tensor | Sequence[int]) -> Tasks:
        """The tasks at these positions of this view; nothing is copied."""
        return replace(self, rows=self.rows[torch.as_tensor(rows, device=self.rows.device)])

    @functools.cached_property  # each time a GPU must be waited for
    def picked_names(self) -> tuple[str, ...]:
        """The names of the tasks in this view, in order."""
        return tuple(self.names[row] for row in self.rows.tolist())

    def weights(self) -> Tensor:
        """What each task of this view counts, [T], so that all kinds count alike; 1 where there are none."""
        if KIND not in self.data:
            return torch.ones(len(self), device=self.rows.device)
        kinds = self.data[KIND][self.rows, 0].long()
        return 1 / kinds.bincount()[kinds]

    def variants(self, data: dict[str, Tensor]) -> Tasks:
        """Augmented tasks, one of each in this view, in order: tensors [T, ...]."""
        names = tuple(f"variant of {name}" for name in self.picked_names)
        return Tasks(names, data, torch.arange(len(names), device=self.rows.device))


Rng = Generator | tuple[Generator, ...]


def drawn(draw: Callable[[Tasks, Generator], Params], tasks: Tasks, rng: Rng) -> Params:
    """Draw for tasks: tensors [T, ...].

    Args:
        draw: (tasks, generator) -> tensors [T, ...].
        tasks: T of them.
        rng: one generator for all, or one for each: then what a task gets does not depend on those beside it.
    """
    if isinstance(rng, Generator):
        return draw(tasks, rng)
    draws = [draw(tasks.select([i]), own) for i, own in enumerate(rng)]
    return {key: torch.cat([one[key] for one in draws]) for key in draws[0]}


def copied(rng: Rng) -> Rng:
    """Generators that go on as these, which stay as they are."""
    if isinstance(rng, Generator):
        return Generator(rng.device).set_state(rng.get_state())
    return tuple(Generator(own.device).set_state(own.get_state()) for own in rng)


def picked(rng: Rng, rows: Sequence[int]) -> Rng:
    """The generators of some tasks; one for all stays."""
    return rng if isinstance(rng, Generator) else tuple(rng[row] for row in rows)
