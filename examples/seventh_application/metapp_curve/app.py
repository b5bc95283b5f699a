"""Curves y(x), such as the response of a camera: a small network, fitted to every other of evenly spaced samples.

The class has all that the five paradigms need of an application. Parameters have a leading task axis T.
"""

from __future__ import annotations

import math
from types import MappingProxyType

import torch
from torch import Generator, Tensor
from torch.nn.functional import gelu
from typing_extensions import override

from metapp.learning.app import App, ErrorMeasure
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec

WIDTH, SAMPLES = 12, 32
SHAPES = {"w1": (WIDTH, 1), "b1": (WIDTH, 1), "w2": (1, WIDTH), "b2": (1, 1)}


class Curve(App):
    """The application of curves: a network of one hidden layer, from x in [-1, 1] to y."""

    name = "curve"
    error_measure = ErrorMeasure("mean absolute difference at held-out samples")
    tensors = MappingProxyType({"y": TensorSpec((SAMPLES,), low=-1e3, high=1e3)})
    small_tensors = True

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Return `x` and `y` [SAMPLES]; fits see the samples of even index, errors use those of odd index."""
        return {"x": torch.linspace(-1, 1, SAMPLES), "y": task.data["y"].float()}

    @override
    def init(self, rng: Generator, count: int) -> Params:
        """Draw Kaiming-normal weights and zero biases."""
        drawn = {key: torch.randn(count, *shape, generator=rng, device=rng.device) for key, shape in SHAPES.items()}
        return {key: value * math.sqrt(2 / value.shape[2]) * key.startswith("w") for key, value in drawn.items()}

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Return `x` and `y` [T, 1, count], drawn from the samples that fits may see."""
        rows = torch.randint(0, SAMPLES // 2, (count,), generator=rng, device=rng.device) * 2
        return {key: tasks.data[key][tasks.rows][:, None, rows] for key in ("x", "y")}

    def value(self, theta: Params, x: Tensor) -> Tensor:
        """Return the fitted curves at x [T, 1, N]."""
        return theta["w2"] @ gelu(theta["w1"] @ x + theta["b1"]) + theta["b2"]

    @override
    def loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the mean squared difference at the samples of a batch, [T]."""
        return (self.value(theta, batch["x"]) - batch["y"]).square().mean((1, 2))

    @override
    def init_encoder(self, rng: Generator) -> Params:
        """Return a linear map from the visible samples to all parameters, which is zero before training, and biases."""
        first = {f"{key}.bias": value[0] for key, value in self.init(rng, 1).items()}
        return first | {f"{key}.map": torch.zeros(*shape, SAMPLES // 2) for key, shape in SHAPES.items()}

    @override
    def encoder_input(self, tasks: Tasks, rng: Generator) -> Batch:
        """Return the visible samples, `y` [T, SAMPLES / 2]."""
        return {"y": tasks.data["y"][tasks.rows][:, ::2]}

    @override
    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        """Return the parameters of the network, [T, ...], as a linear function of the visible samples."""
        return {
            key: encoder[f"{key}.bias"] + torch.einsum("oik,tk->toi", encoder[f"{key}.map"], encoder_input["y"])
            for key in SHAPES
        }

    @override
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """Return the mean absolute difference at held-out samples, [T]."""
        return self.errors_of(self.value(theta, tasks.data["x"][tasks.rows][:, None, 1::2]), tasks)

    def errors_of(self, prediction: Tensor, tasks: Tasks) -> dict[str, Tensor]:
        """Return the mean absolute difference of values [T, 1, SAMPLES / 2] at held-out samples, [T], for baselines."""
        return {"error": (prediction - tasks.data["y"][tasks.rows][:, None, 1::2]).abs().mean((1, 2))}
