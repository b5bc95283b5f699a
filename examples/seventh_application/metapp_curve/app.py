"""Curves y(x), such as the response of a camera: a small network, fitted to every other of evenly spaced samples.

An application is four components: a decoder says what parameters mean, a sight what a fit sees, a judge how answers are
judged, and an encoder how General predicts parameters. Parameters have a leading task axis T.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import gelu
from typing_extensions import override

from metapp.learning.app import App, ErrorMeasure
from metapp.learning.components import Decoder, Encoder, Judge, Sight
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec, add_task_axis
from metapp_curve.plot import Plot

WIDTH, SAMPLES = 12, 32
SHAPES = {"w1": (WIDTH, 1), "b1": (WIDTH, 1), "w2": (1, WIDTH), "b2": (1, 1)}

Function = Callable[[Tensor], Tensor]  # from x [T, 1, N] to y [T, 1, N]


class SeenSamples(NamedTuple):
    """The samples of even index, `x` and `y` [T, 1, SAMPLES / 2], which fits see."""

    x: Tensor
    y: Tensor


class HeldOutSamples(NamedTuple):
    """The samples of odd index, `held_out_x` and `held_out_y` [T, 1, SAMPLES / 2], which no fit sees."""

    held_out_x: Tensor
    held_out_y: Tensor


@dataclass(frozen=True)
class CurveNetwork(Decoder[Function, SeenSamples]):
    """The decoder of curves: a network of one hidden layer, from x in [-1, 1] to y."""

    @override
    def init(self, rng: Generator, count: int) -> Params:
        """Draw Kaiming-normal weights and zero biases."""
        drawn = {key: torch.randn(count, *shape, generator=rng, device=rng.device) for key, shape in SHAPES.items()}
        return {key: value * math.sqrt(2 / value.shape[2]) * key.startswith("w") for key, value in drawn.items()}

    @override
    def __call__(self, theta: Params, seen: SeenSamples | None = None) -> Function:
        return functools.partial(self.evaluate, theta)

    def evaluate(self, theta: Params, x: Tensor) -> Tensor:
        """Return the fitted curves at x [T, 1, N]."""
        return theta["w2"] @ gelu(theta["w1"] @ x + theta["b1"]) + theta["b2"]


@dataclass(frozen=True)
class EvenSight(Sight[Function, SeenSamples]):
    """The sight of the samples of even index: random ones in each step."""

    seen_type = SeenSamples

    @override
    def prepare(self, task: Task, decoder: CurveNetwork) -> SeenSamples:
        return SeenSamples(*(values[None, ::2] for values in sample_curve(task)))

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> SeenSamples:
        rows = torch.randint(0, SAMPLES // 2, (count,), generator=rng, device=rng.device)
        return SeenSamples(*(values[..., rows] for values in self.gather(tasks)))

    @override
    def loss(self, answer: Function, seen: SeenSamples, loss_parameters: Params) -> Tensor:
        """Return the mean squared difference, [T]."""
        return (answer(seen.x) - seen.y).square().mean((1, 2))


@dataclass(frozen=True)
class OddJudge(Judge[Function, SeenSamples, HeldOutSamples]):
    """The judge of curves by the samples of odd index."""

    truth_type = sampled_type = HeldOutSamples

    @override
    def prepare(self, task: Task, decoder: CurveNetwork) -> HeldOutSamples:
        return HeldOutSamples(*(values[None, 1::2] for values in sample_curve(task)))

    @override
    def reference(self, task: Task) -> Plot:
        return Plot(task.data["y"].float())

    @override
    def query(self, answer: Function, truth: HeldOutSamples) -> Tensor:
        """Return the values of curves at the held-out samples, [T, 1, SAMPLES / 2]."""
        return answer(truth.held_out_x)

    @override
    def errors(self, prediction: Tensor, seen: SeenSamples, truth: HeldOutSamples) -> dict[str, Tensor]:
        """Return the mean absolute difference of values at the held-out samples, [T]."""
        return {"error": (prediction - truth.held_out_y).abs().mean((1, 2))}

    @override
    def outer_loss(self, answer: Function, seen: SeenSamples, truth: HeldOutSamples) -> Tensor:
        """Return the mean squared difference at the held-out samples, [T]."""
        return (answer(truth.held_out_x) - truth.held_out_y).square().mean((1, 2))


@dataclass(frozen=True)
class LinearEncoder(Encoder[SeenSamples]):
    """The encoder of curves: all parameters of the network are linear functions of the samples that fits see."""

    @override
    def init(self, rng: Generator, decoder: CurveNetwork) -> Params:
        """Return a linear map, which is zero before training, and biases."""
        first = {f"{key}.bias": value[0] for key, value in decoder.init(rng, 1).items()}
        return first | {f"{key}.map": torch.zeros(*shape, SAMPLES // 2) for key, shape in SHAPES.items()}

    @override
    def select_input(self, seen: SeenSamples) -> Batch:
        return {"y": seen.y[:, 0]}

    @override
    def __call__(self, encoder: Params, encoder_input: Batch, decoder: CurveNetwork) -> Params:
        return {
            key: encoder[f"{key}.bias"] + torch.einsum("oik,tk->toi", encoder[f"{key}.map"], encoder_input["y"])
            for key in SHAPES
        }


@dataclass(frozen=True)
class Curve(App):
    """The application of curves, which names its components."""

    decoder: CurveNetwork = CurveNetwork()
    sight: EvenSight = EvenSight()
    judge: OddJudge = OddJudge()
    encoder: LinearEncoder = LinearEncoder()

    name = "curve"
    error_measure = ErrorMeasure("mean absolute difference at held-out samples")
    tensors = MappingProxyType({"y": TensorSpec((SAMPLES,), low=-1e3, high=1e3)})
    small_tensors = True


def make_plot(app: Curve, theta: Params, task: Task, size: tuple[int, int] | None) -> Plot:
    """Return the curve of a fit."""
    x = torch.linspace(-1, 1, SAMPLES)[None, None]
    return Plot(app.decoder.evaluate(add_task_axis(theta), x)[0, 0].detach())


def sample_curve(task: Task) -> tuple[Tensor, Tensor]:
    """Return x and y of all samples of a task, [SAMPLES] each."""
    return torch.linspace(-1, 1, SAMPLES), task.data["y"].float()
