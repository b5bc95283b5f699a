"""General of networks that read what is seen: one network for all tasks, which needs no code of a task."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Generator
from typing_extensions import override

from metapp.apps.svbrdf_nonstationary.rti.curve_network import CurveNetwork, LitTexels
from metapp.learning.components import Encoder
from metapp.learning.task import Batch, Params


@dataclass(frozen=True)
class MeanEncoder(Encoder[LitTexels]):
    """The encoder that predicts the same parameters for every task: its own."""

    @override
    def init(self, rng: Generator, decoder: CurveNetwork) -> Params:
        return {name: value[0] for name, value in decoder.init(rng, 1).items()}

    @override
    def select_input(self, seen: LitTexels) -> Batch:
        """Return `lamps`, of which the number of tasks counts."""
        return {"lamps": seen.lamps}

    @override
    def __call__(self, encoder: Params, encoder_input: Batch, decoder: CurveNetwork) -> Params:
        count = len(encoder_input["lamps"])
        return {name: value.expand(count, *value.shape) for name, value in encoder.items()}
