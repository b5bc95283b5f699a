"""The nouns: what a task is, what an application is, and the one tree that all parameters live in."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

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


class Held(NamedTuple):
    """What a tensor of a task must be.

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


_KINDS = {"float": (torch.float16, torch.float32, torch.float64), "uint8": (torch.uint8,)}


def problems_of(task: Task, holds: Mapping[str, Held]) -> list[str]:
    """What is wrong with a task's tensors, a line each: found, expected.

    Args:
        task: from a file that anybody may have written.
        holds: what it must hold, by name; further tensors need only be finite.
    """
    missing = [key for key, held in holds.items() if key not in task.data and not held.optional]
    problems = [f"tensor '{key}' is missing, expected {_said(holds[key])}" for key in missing]
    sizes: dict[str, int] = {}
    for key, tensor in task.data.items():
        held = holds.get(key)
        if tensor.is_floating_point() and tensor.dtype not in _KINDS["float"]:
            problems.append(f"tensor '{key}' is {_of(tensor)}, expected floats of 16, 32 or 64 bits")
        elif held and (tensor.dtype not in _KINDS[held.kind] or not _has_shape(tensor, held.shape, sizes)):
            problems.append(f"tensor '{key}' is {_of(tensor)}, expected {_said(held)}")
        elif not bool(torch.isfinite(tensor).all()):
            problems.append(f"tensor '{key}' holds NaN or infinite values, expected finite ones")
        elif held and not held.low <= float(tensor.min()) <= float(tensor.max()) <= held.high:
            found = f"{float(tensor.min()):g} to {float(tensor.max()):g}"
            problems.append(f"tensor '{key}' holds {found}, expected {held.low:g} to {held.high:g}")
    return problems


def _has_shape(tensor: Tensor, shape: tuple[int | str, ...], sizes: dict[str, int]) -> bool:
    """Whether a shape fits, given what letters stand for so far; what they stand for here is added."""
    if tensor.ndim != len(shape) or tensor.numel() == 0:
        return False
    pairs = zip(tensor.shape, shape, strict=True)
    return all(size == (sizes.setdefault(of, size) if isinstance(of, str) else of) for size, of in pairs)


def _of(tensor: Tensor) -> str:
    return f"{str(tensor.dtype).removeprefix('torch.')} {list(tensor.shape)}"


def _said(held: Held) -> str:
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

    def picked_names(self) -> tuple[str, ...]:
        """The names of the tasks in this view, in order."""
        return tuple(self.names[row] for row in self.rows.tolist())

    def variants(self, data: dict[str, Tensor]) -> Tasks:
        """Made-up relatives of the tasks in this view, one of each, in order: tensors [T, ...]."""
        names = tuple(f"variant of {name}" for name in self.picked_names())
        return Tasks(names, data, torch.arange(len(names), device=self.rows.device))


@dataclass(frozen=True)
class Adam:
    """Settings of a plain Adam descent: the rate decays from `rate` by a half cosine to `rate * final`."""

    rate: float
    beta1: float = 0.9
    beta2: float = 0.999
    eps: float = 1e-8
    final: float = 1.0


@dataclass(frozen=True)
class Training:
    """How a start is prepared on the training tasks.

    Attributes:
        steps: outer steps.
        tasks: tasks per outer step.
        first: the Adam that a learned rule is before training; SGD of this rate for meta-sgd.
        rates: outer Adam's rate by the first part of a parameter's name ("" is the rate of all others).
        tuned: search that Adam on validation tasks, as QuickFT's, before the outer steps, if any.
        warmup: outer steps of linear warm-up.
        final: the rate's last value over its first, reached by a half cosine.
        decay: weight decay (L2) of the outer Adam.
        order: derivative carried through the inner steps: 1 (FOMAML) or 2 (MAML); 0 where there are none.
        clip: each task's outer gradient is scaled down to this norm before the mean is taken.
        tasks_at_once: tasks that are walked back together, where memory is short; None for all.
        validate_every: outer steps between two looks at the validation tasks.
        augment: train on made-up relatives of the tasks.
        start: Meta's first start: "random"; "mean" of General's predictions; "encoder", General's own, which starts
            each task at its prediction and which outer steps, if any, train through the inner ones.
    """

    steps: int
    tasks: int
    rates: dict[str, float]
    first: Adam = Adam(5e-3, beta2=0.99)
    tuned: bool = False
    warmup: int = 0
    final: float = 1.0
    decay: float = 0.0
    order: int = 0
    clip: float = float("inf")
    tasks_at_once: int | None = None
    validate_every: int = 250
    augment: bool = True
    start: Literal["random", "mean", "encoder"] = "mean"


# Fischer & Ritschel 2022, supplement: first-order MAML with Meta-SGD from a random start, meta-batch 5
AS_PUBLISHED = Training(steps=100_000, tasks=5, rates={"": 1e-4}, first=Adam(1e-3), order=1, clip=10.0, start="random")


@dataclass(frozen=True)
class Recipe:
    """Everything a run may vary, for one application; a record stores the one it used.

    Attributes:
        steps: n_l, Meta's and QuickFT's number of gradient steps.
        batch: samples b that one gradient step sees.
        overfit_steps, overfit: Overfit's number of steps and its Adam.
        finetune_steps, finetune: the same for Finetune.
        quickft: QuickFT's Adam, tuned on validation tasks.
        general: how General's encoder is trained.
        meta: how each rule's start is trained, by the rule's name.
        rule: the rule that is best on validation tasks: Meta's default.
        setup: the application's own settings, such as sizes; None where it has none.
    """

    steps: int
    batch: int
    overfit_steps: int
    overfit: Adam
    finetune_steps: int
    finetune: Adam
    quickft: Adam
    general: Training
    meta: dict[str, Training]
    rule: str
    setup: Any = None


class Visible(NamedTuple):
    """What a fit may see of a task.

    Attributes:
        samples: how many it draws from; 1 where each step sees all there is.
        size: bytes of one, as data sets keep it.
        encoder: samples that General's encoder reads of these.
    """

    samples: int
    size: int
    encoder: int


REFERENCE = "reference"  # among measures of pictures: what the references are off by themselves


class Fitted(NamedTuple):
    """A fit of one task: parameters without task axis, and the seconds of inference that it took."""

    theta: Params
    seconds: float


class App(ABC):
    """An application: a network, the samples it is fitted to, and the distance that says how well it fits.

    All methods are batched over tasks: parameters and batches have a leading task axis T.

    Attributes:
        name: as on the command line.
        title: as in tables.
        readers: modules of data_tools that turn a user's files into tasks: `recognises(path)` says whether a path is
            theirs, `find(paths)` lists sources and lines about what was skipped, `read_task(source)` reads one.
        inputs: what a user's files may be, in words.
        holds: what each task must hold, by the tensor's name.
        exports: modules of data_tools whose `export(app, theta, path)` writes a fit in another form.
        protocols: what a fit may see, the values of --observe, where there are several; the first is the default.
        protocol: the one of these that is in force; "" where there is none.
        measure: what the error is, in one line.
        scale: factor of a printed error; 100 where the paper prints x100.
        small_kernels: True where threads and GPUs only slow the network down, fitted to one task.
        wraps: True where the columns of parameters on a grid, those of three axes, go on at the grid's other edge.
        logarithmic: True where the error is a logarithm, of any sign: of two, the difference counts, not the ratio.
        random: False where nothing that a fit sees is drawn at random, so that one fit says what two would.
        recipes: "paper" and "quick".
        raw: names of those `files` that are linear data and no colours, such as normals; all others are sRGB.
        heights: names of those raw `files` that are heights in texels, of any range: kept stretched to [0, 1], with
            both ends as the text of the PNG.
        radiance: names of those `files` that are linear radiance of any range, kept as EXR.
        image_measure: what `image_errors` are of, in one line; "" where there are none.
        image_seconds: that they take a task, about, to tell the time left before any was measured.
    """

    name: str
    title: str
    readers: tuple[str, ...]
    inputs: str
    holds: Mapping[str, Held] = MappingProxyType({})
    exports: tuple[str, ...] = ()
    protocols: tuple[str, ...] = ()
    protocol: str = ""
    measure: str
    scale: float = 1.0
    small_kernels: bool = False
    wraps: bool = False
    logarithmic: bool = False
    random: bool = True
    recipes: dict[str, Recipe]
    raw: tuple[str, ...] = ()
    heights: tuple[str, ...] = ()
    radiance: tuple[str, ...] = ()
    image_measure: str = ""
    image_seconds: float = 0.1

    def at(self, recipe: Recipe, observe: str = "") -> App:
        """The application at a recipe's setup, under a protocol, its first one where none is named."""
        return self

    def conditions(self) -> dict[str, str]:
        """What else its errors depend on, by name: part of every record, and said wherever errors are printed."""
        return {}

    @abstractmethod
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """What fitting needs of a task, computed once: tensors without a task axis."""

    @abstractmethod
    def init(self, rng: Generator, count: int) -> Params:
        """Random network parameters for `count` tasks, each tensor [count, ...]."""

    @abstractmethod
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """`count` random samples of each task, from the part a fit may see; tensors [T, ...]."""

    @abstractmethod
    def loss(self, theta: Params, batch: Batch, shape: Params) -> Tensor:
        """The loss of each task, [T]; `shape` holds learned quantities of the loss, {} for the plain one."""

    def goal(self, theta: Params, batch: Batch, shape: Params) -> Tensor:
        """What preparation wants of a fit, [T]: the loss itself, unless training tasks know more than a fit may see."""
        return self.loss(theta, batch, shape)

    def shape(self, steps: int) -> Params:
        """Initial values [steps, ...] of the quantities of the inner loss that a rule may learn."""
        return {}

    @abstractmethod
    def init_encoder(self, rng: Generator) -> Params:
        """Random parameters of General's encoder."""

    @abstractmethod
    def observe(self, tasks: Tasks, rng: Generator) -> Batch:
        """The condition I that General's encoder sees of each task."""

    @abstractmethod
    def encode(self, encoder: Params, observed: Batch) -> Params:
        """Network parameters from the condition, one forward pass; tensors [T, ...]."""

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Made-up tasks related to these, as many, for training only."""
        return tasks

    @abstractmethod
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """Error measures [T] on the part of each task that fits never see; "error" is the table's, unscaled.

        Empty where the tasks hold no reference.
        """

    @abstractmethod
    def outputs(self, theta: Params, task: Task) -> dict[str, Any]:
        """Linear RGB pictures [H, W, 3 or 4] of one fitted task and its reference, by name (no task axis in theta)."""

    def visible(self, task: Task) -> Visible | None:
        """How much a fit may see of a task; None where the application does not say."""
        return None

    def image_errors(self, fits: Mapping[str, Fitted], task: Task) -> dict[str, dict[str, float]]:
        """Measures of the pictures that fits of a task make, by the fit's name, then by the measure's, such as SSIM.

        There may be further names, of pictures that are made without any fit; REFERENCE is of the references' own
        error. Of measures whose name begins with SSIM
        more is better, of others less. Empty where there are none.
        """
        return {}

    def files(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """What a fit makes for its user, by file name: display values [H, W, 1 or 3] in [0, 1], kept as PNG.

        Those named in `raw` are linear data; of these, those in `heights` may have any range. Those named in `radiance`
        are linear, of any range, and kept as EXR.
        """
        return {}


def stack(app: App, tasks: Sequence[Task], device: torch.device | str = "cpu") -> Tasks:
    """Prepare tasks and put them side by side.

    Raises:
        ValueError: there is no task, or they differ in their tensors' shapes.
    """
    if not tasks:
        raise ValueError(f"{app.name}: 0 tasks, expected at least one; give input files or another data set.")
    prepared = [app.prepare(task) for task in tasks]
    for task, each in zip(tasks, prepared, strict=True):
        for key, value in prepared[0].items():
            if each[key].shape != value.shape:
                raise ValueError(
                    f"{task.name}: {key} {tuple(each[key].shape)}, expected {tuple(value.shape)} as of "
                    f"{tasks[0].name}; convert both with the same settings."
                )
    data = {key: _stack([each[key] for each in prepared], device) for key in prepared[0]}
    names, groups = (task.name for task in tasks), (task.group or task.name for task in tasks)
    return Tasks(tuple(names), data, torch.arange(len(tasks), device=device), tuple(groups))


def _stack(tensors: list[Tensor], device: torch.device | str) -> Tensor:
    """Stack, or share one copy where all are the same tensor, as sample positions of a data set often are."""
    first = tensors[0]
    if len(tensors) > 1 and all(torch.equal(first, other) for other in tensors[1:]):
        return first.to(device).expand(len(tensors), *first.shape)
    return torch.stack(tensors).to(device)
