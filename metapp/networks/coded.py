"""Encoders for networks that have a code in every place, which is read from a photograph.

The functions below split General's parameters into a reader of the encoder input and a decoder that all tasks share.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection
from typing import Any

from torch import Generator, Tensor
from typing_extensions import override

from metapp.learning.components import Encoder
from metapp.learning.learn import expand_tasks
from metapp.learning.task import Batch, Params, select_prefixed
from metapp.networks.field import LocalField, regrid


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
    return select_prefixed(encoder, "encoder.")


def select_decoder(encoder: Params) -> Params:
    """Select the parameters that all tasks share, by name, from General's: those called `decoder.<name>`."""
    return select_prefixed(encoder, "decoder.")


def add_decoder(predicted: Params, encoder: Params) -> Params:
    """Add General's decoder, whose parameters are equal for all tasks, to predicted parameters.

    Args:
        predicted: the parameters that the reader predicted for each task, [T, ...].
        encoder: General's parameters, whose `decoder.<name>` have no task axis.

    Returns:
        All parameters of the network, [T, ...].
    """
    return predicted | expand_tasks(select_decoder(encoder), len(next(iter(predicted.values()))), 0)
