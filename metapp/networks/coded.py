"""Applications whose network has a code in every place, which General's encoder reads from a photograph.

The functions below split General's parameters into a reader of the encoder input and a decoder that all tasks share.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.learning.app import App
from metapp.learning.composed import Encoder
from metapp.learning.rounding import round_absolute
from metapp.learning.task import Batch, Params, Tasks
from metapp.networks.field import LocalField, regrid

INITIAL_SMOOTHING = 0.3  # of |d| in losses, in their unit, before a rule has learned it


def initial_smoothing(steps: int) -> Params:
    """Return the initial value of the loss parameter `smoothing` [steps], which :func:`smooth_absolute` reads."""
    return {"smoothing": torch.full((steps,), math.log(INITIAL_SMOOTHING))}


class CodeEncoder(Encoder[Any]):
    """An encoder of photographs for decoders that are a field, `decoder.network`.

    A reader predicts the code z of a task, and further parameters, from `photo` [T, 3, S, S]; the field's other
    parameters are then equal for all tasks. It may predict a coarser code than the field has, so that recipes of
    several sizes share checkpoints of the smallest one.
    """

    @abstractmethod
    def init_reader(self, rng: Generator, network: LocalField) -> Params:
        """Draw random parameters of the reader of photographs."""

    @abstractmethod
    def read(self, reader: Params, photos: Tensor, network: LocalField) -> Params:
        """Read the parameters that tasks do not share, [T, ...] each, from their photographs [T, 3, S, S]."""

    @override
    def init(self, rng: Generator, decoder: Any) -> Params:
        """Draw the reader of photographs, then the parameters of the field that all tasks share."""
        return join_encoder(self.init_reader(rng, decoder.network), decoder.network.init(rng, 1), ("z",))

    @override
    def select_input(self, seen: Any) -> Batch:
        return {"photo": seen.photo}

    @override
    def __call__(self, encoder: Params, encoder_input: Batch, decoder: Any) -> Params:
        network: LocalField = decoder.network
        theta = self.read(select_reader(encoder), encoder_input["photo"], network)
        theta["z"] = regrid(theta["z"], network.rows, network.columns, periodic=network.periodic)
        return add_decoder(theta, encoder)


@dataclass(frozen=True)
class CodedApp(App):
    """A field for each task, fitted to the thing itself ("reference") or to one photograph of it alone ("photo").

    General's encoder reads a task's parameters, the code z among them, from `photo` [T, 3, S, S]; the field's other
    parameters are then equal for all tasks. It may read a coarser code than the field has, so that recipes of several
    sizes share checkpoints of the smallest one. Nothing that a fit sees is drawn at random.

    Attributes:
        network: the field of one task.
    """

    network: LocalField = field()

    small_tensors = deterministic = True

    @override
    def initial_loss_parameters(self, steps: int) -> Params:
        return {"smoothing": torch.full((steps,), math.log(INITIAL_SMOOTHING))}

    @property
    @override
    def is_periodic(self) -> bool:
        return self.network.periodic

    @override
    def init(self, rng: Generator, count: int) -> Params:
        return self.network.init(rng, count)

    def init_reader(self, rng: Generator) -> Params:
        """Draw random parameters of the reader of photographs."""
        raise NotImplementedError

    def read(self, reader: Params, photos: Tensor) -> Params:
        """Read the parameters that tasks do not share, [T, ...] each, from their photographs [T, 3, S, S]."""
        raise NotImplementedError

    @override
    def init_encoder(self, rng: Generator) -> Params:
        """Draw the reader of photographs, then the parameters of the field that all tasks share."""
        return join_encoder(self.init_reader(rng), self.network.init(rng, 1), ("z",))

    @override
    def encoder_input(self, tasks: Tasks, rng: Generator) -> Batch:
        return {"photo": tasks.data["photo"][tasks.rows]}

    @override
    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        theta, network = self.read(select_reader(encoder), encoder_input["photo"]), self.network
        theta["z"] = regrid(theta["z"], network.rows, network.columns, periodic=network.periodic)
        return add_decoder(theta, encoder)

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Return all data of each task."""
        return {key: value[tasks.rows] for key, value in tasks.data.items()}


def join_encoder(reader: Params, theta: Params, predicted: Collection[str]) -> Params:
    """Join the parameters of General: a reader of the encoder input, and the network's parameters that all tasks share.

    Args:
        reader: the parameters of the reader; they are called `encoder.<name>` in the result.
        theta: the network's parameters [1, ...]; without a task axis they are called `decoder.<name>`.
        predicted: the names of the network's parameters that the reader predicts for each task; they are left out.
    """
    shared = {f"decoder.{key}": value[0] for key, value in theta.items() if key not in predicted}
    return {f"encoder.{key}": value for key, value in reader.items()} | shared


def select_reader(encoder: Params) -> Params:
    """Select the reader's parameters, by name, from General's: those called `encoder.<name>`."""
    return {key.removeprefix("encoder."): value for key, value in encoder.items() if key.startswith("encoder.")}


def add_decoder(predicted: Params, encoder: Params) -> Params:
    """Add General's decoder, whose parameters are equal for all tasks, to predicted parameters.

    Args:
        predicted: the parameters that the reader predicted for each task, [T, ...].
        encoder: General's parameters, whose `decoder.<name>` have no task axis.

    Returns:
        All parameters of the network, [T, ...].
    """
    shared = {key.removeprefix("decoder."): value for key, value in encoder.items() if key.startswith("decoder.")}
    count = len(next(iter(predicted.values())))
    return predicted | {key: value.expand(count, *value.shape) for key, value in shared.items()}


def smooth_absolute(difference: Tensor, loss_parameters: Params) -> Tensor:
    """Return |d| of differences d [T, ...], or sqrt(d^2 + s^2) - s where a rule has learned the loss parameter s.

    Args:
        difference: the differences.
        loss_parameters: `smoothing` [T], the logs of s; {} for |d|.
    """
    if not loss_parameters:
        return difference.abs()
    return round_absolute(difference, torch.exp(loss_parameters["smoothing"]))
