"""Curves y(x), such as the response of a camera: a small network, fitted to every other of evenly spaced samples."""

from __future__ import annotations

import math
from types import MappingProxyType

import torch
from torch import Generator, Tensor
from torch.nn.functional import gelu

from metapp.learning.app import App, ErrorMeasure
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec

WIDTH, SAMPLES = 12, 32
SHAPES = {"w1": (WIDTH, 1), "b1": (WIDTH, 1), "w2": (1, WIDTH), "b2": (1, 1)}


class Curve(App):
    """The application; parameters have a leading task axis T."""

    name = "curve"
    error_measure = ErrorMeasure("mean absolute difference at held-out samples")
    tensors = MappingProxyType({"y": TensorSpec((SAMPLES,), low=-1e3, high=1e3)})
    single_threaded = cheap_fits = True

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """`x` and `y` [SAMPLES]; even ones are for fits to see, odd ones for tests."""
        return {"x": torch.linspace(-1, 1, SAMPLES), "y": task.data["y"].float()}

    def init(self, rng: Generator, count: int) -> Params:
        """Kaiming-normal weights, zero biases."""
        drawn = {key: torch.randn(count, *shape, generator=rng, device=rng.device) for key, shape in SHAPES.items()}
        return {key: value * math.sqrt(2 / value.shape[2]) * key.startswith("w") for key, value in drawn.items()}

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """`x` and `y` [T, 1, count], drawn from what fits may see."""
        rows = torch.randint(0, SAMPLES // 2, (count,), generator=rng, device=rng.device) * 2
        return {key: tasks.data[key][tasks.rows][:, None, rows] for key in ("x", "y")}

    def value(self, theta: Params, x: Tensor) -> Tensor:
        """The fitted curves at x [T, 1, N]."""
        return theta["w2"] @ gelu(theta["w1"] @ x + theta["b1"]) + theta["b2"]

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Mean squared difference, [T]."""
        return (self.value(theta, batch["x"]) - batch["y"]).square().mean((1, 2))

    def init_encoder(self, rng: Generator) -> Params:
        """A linear map from the visible samples to all parameters."""
        first = {f"{key}.bias": value[0] for key, value in self.init(rng, 1).items()}
        return first | {f"{key}.map": torch.zeros(*shape, SAMPLES // 2) for key, shape in SHAPES.items()}

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        """`y` [T, SAMPLES / 2], the visible samples."""
        return {"y": tasks.data["y"][tasks.rows][:, ::2]}

    def encode(self, encoder: Params, condition: Batch) -> Params:
        """Parameters of the network, [T, ...]."""
        return {
            key: encoder[f"{key}.bias"] + torch.einsum("oik,tk->toi", encoder[f"{key}.map"], condition["y"])
            for key in SHAPES
        }

    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """Mean absolute difference at held-out samples, [T]."""
        return self.errors_of(self.value(theta, tasks.data["x"][tasks.rows][:, None, 1::2]), tasks)

    def errors_of(self, answer: Tensor, tasks: Tasks) -> dict[str, Tensor]:
        """The same of values [T, 1, SAMPLES / 2] at held-out samples."""
        return {"error": (answer - tasks.data["y"][tasks.rows][:, None, 1::2]).abs().mean((1, 2))}
