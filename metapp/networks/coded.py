"""Applications whose network has a code in every place, which General's encoder reads from a photograph."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field

import torch
from torch import Generator, Tensor

from metapp.learning.app import App
from metapp.learning.task import Batch, Params, Tasks
from metapp.networks.field import LocalField, regrid

CHEAP_TEXELS = 64 * 64  # texels of a field that a search can afford to fit for all validation tasks


@dataclass(frozen=True)
class CodedApp(App):
    """A `LocalField` a task, fitted to the thing itself ("reference") or to one photograph of it alone ("photo").

    General's encoder makes a task's own parameters, the code z among them, of `photo` [T, 3, S, S]; the field's other
    parameters are then the same for all tasks. It may read a coarser code than the field has, so that recipes of
    several sizes share checkpoints of the smallest. Nothing that a fit sees is drawn at random.

    Attributes:
        network: of one task.
    """

    network: LocalField = field()

    single_threaded = deterministic = True

    @property
    def cheap_fits(self) -> bool:
        return self.network.height * self.network.width <= CHEAP_TEXELS

    def loss_parameters(self, steps: int) -> Params:
        return {"smoothing": torch.full((steps,), math.log(0.3))}

    def init_reader(self, rng: Generator) -> Params:
        """Random parameters of the reader of photographs."""
        raise NotImplementedError

    def read(self, reader: Params, photos: Tensor) -> Params:
        """A task's own parameters, [T, ...] each, from its photograph."""
        raise NotImplementedError

    def init_encoder(self, rng: Generator) -> Params:
        """The reader of photographs, and the parameters of the field that all tasks share."""
        return join_encoder(self.init_reader(rng), self.network.init(rng, 1), ("z",))

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        return {"photo": tasks.data["photo"][tasks.rows]}

    def encode(self, encoder: Params, condition: Batch) -> Params:
        own, network = self.read(select_reader(encoder), condition["photo"]), self.network
        own["z"] = regrid(own["z"], network.rows, network.columns, periodic=network.periodic)
        return add_decoder(own, encoder)

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """All there is of each task."""
        return {key: value[tasks.rows] for key, value in tasks.data.items()}


def join_encoder(reader: Params, theta: Params, own: Collection[str]) -> Params:
    """General's encoder: a reader of a task's own parameters from a condition, and the network's shared parameters.

    Args:
        reader: becomes `encoder.<name>`.
        theta: the network's parameters [1, ...]; without a task axis they become `decoder.<name>`.
        own: names of those that the reader predicts, which are left out.
    """
    shared = {f"decoder.{key}": value[0] for key, value in theta.items() if key not in own}
    return {f"encoder.{key}": value for key, value in reader.items()} | shared


def select_reader(encoder: Params) -> Params:
    """The part of General's encoder that reads the condition, `encoder.<name>`, by name."""
    return {key.removeprefix("encoder."): value for key, value in encoder.items() if key.startswith("encoder.")}


def add_decoder(own: Params, encoder: Params) -> Params:
    """Tasks' own parameters [T, ...], and those of General's decoder, the same for each."""
    shared = {key.removeprefix("decoder."): value for key, value in encoder.items() if key.startswith("decoder.")}
    count = len(next(iter(own.values())))
    return own | {key: value.expand(count, *value.shape) for key, value in shared.items()}


def smooth_absolute(difference: Tensor, learned: Params) -> Tensor:
    """|d|, or sqrt(d^2 + s^2) - s if a rule has learned an s for each task: the loss's parameter `smoothing`."""
    if not learned:
        return difference.abs()
    s = torch.exp(learned["smoothing"]).reshape(-1, *[1] * (difference.ndim - 1))
    return (difference * difference + s * s).sqrt() - s
