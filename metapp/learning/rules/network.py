"""Learned gradient descent: a convolutional network that adds to a rule's steps of a parameter that lies on a grid.

The network reads the parameter, its gradient, the rule's direction and a memory of its own from the steps before. Its
output is added to the rule's own step (Adler & Oektem 2017; Putzky & Welling 2017). It thus learns which changes of
its neighbourhood a gradient calls for, if the loss alone leaves that open.

Its weights are learned hyperparameters, `around.<parameter>.*` if the grid's columns go on at the other edge, else
`within.<parameter>.*`; all but the shifts are shared by all steps.
"""

from __future__ import annotations

import math

import torch
from torch import Generator, Tensor
from torch.nn.functional import conv2d, leaky_relu, pad

from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.rules.rule import Part, StepInput
from metapp.learning.task import Params

HIDDEN_CHANNELS = 32  # channels of its two inner layers
MEMORY_CHANNELS = 16  # channels of what it remembers from step to step
PARAMETER_UNIT_STEPS = 10  # how many times a step's length the parameter is measured in
LEAKY_RELU_SLOPE = 0.1


def is_periodic(app: App) -> bool:
    """Return whether the columns of an application's parameters on a grid go on at the grid's other edge."""
    return bool(getattr(app.network, "periodic", False))


class StepNetwork(Part):
    """A convolutional network for each parameter of three axes, [channels, rows, columns]."""

    name = "network"

    def refusal(self, app: App, theta: Params) -> str:
        """It needs a parameter on a grid."""
        on_grid = any(value.ndim == 3 for value in theta.values())
        return "" if on_grid else "no parameter lies on a grid, which has three axes"

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """Random inner layers and last ones of zeros: such a network adds nothing and leaves its memory empty.

        Its moves are measured in the rate of `first`, the length of the rule's own steps.
        """
        alpha: Params = {}
        rng = Generator().manual_seed(0)
        for key, value in theta.items():
            if value.ndim == 3:
                channels, name = len(value), f"{'around' if is_periodic(app) else 'within'}.{key}"
                for i, inputs in enumerate((3 * channels + 1 + MEMORY_CHANNELS, HIDDEN_CHANNELS)):
                    kernel = torch.randn(1, HIDDEN_CHANNELS, inputs, 3, 3, generator=rng) * math.sqrt(2 / (9 * inputs))
                    alpha |= {
                        f"{name}.kernel{i}": kernel,
                        f"{name}.shift{i}": torch.zeros(steps, HIDDEN_CHANNELS, 1, 1),
                    }
                alpha |= {
                    f"{name}.place": torch.zeros(1, HIDDEN_CHANNELS, *value.shape[1:]),
                    f"{name}.kernel2": torch.zeros(1, channels + MEMORY_CHANNELS, HIDDEN_CHANNELS, 3, 3),
                    f"{name}.shift2": torch.zeros(steps, channels + MEMORY_CHANNELS, 1, 1),
                    f"{name}.unit": torch.full((1,), math.log(first.rate)),
                }
        return alpha

    def state(self, alpha: Params, theta: Params) -> Params:
        """Empty memories, `memory.<parameter>` [T, MEMORY, rows, columns]."""
        return {
            f"memory.{key}": value.new_zeros(len(value), MEMORY_CHANNELS, *value.shape[2:])
            for key, value in theta.items()
            if _name_of(alpha, key)
        }

    def moved(self, alpha: Params, moved: Params, before: StepInput, state: Params) -> tuple[Params, Params]:
        """The parameters plus the output of the networks."""
        results, memories = dict(moved), {}
        for key, value in before.theta.items():
            if name := _name_of(alpha, key):
                memory = state[f"memory.{key}"]
                added, written = _move(alpha, name, value, before.grads[key], before.directions[key], memory)
                results[key], memories[f"memory.{key}"] = moved[key] + added, written
        return results, memories


def _name_of(alpha: Params, key: str) -> str:
    """The name of a parameter's network in alpha; "" if it has none."""
    return next((f"{edge}.{key}" for edge in ("around", "within") if f"{edge}.{key}.unit" in alpha), "")


def _move(
    alpha: Params, name: str, value: Tensor, grad: Tensor, direction: Tensor, memory: Tensor
) -> tuple[Tensor, Tensor]:
    """The addition of a network to a parameter, and its memory after that.

    Args:
        alpha: the hyperparameters of this step, with a task axis.
        name: the network's.
        value: the parameter [T, channels, rows, columns].
        grad: its gradient; the network reads each task's at length 1, and the logarithm of its length.
        direction: the rule's own, before any rate.
        memory: its own from the steps before, [T, MEMORY, rows, columns].
    """
    unit = torch.exp(alpha[f"{name}.unit"])[:, None, None, None]
    size = (grad.square().mean((1, 2, 3), keepdim=True) + 1e-24).sqrt()
    log_size = 0.3 * size.log().expand(-1, 1, *grad.shape[2:])
    x = torch.cat([value / (PARAMETER_UNIT_STEPS * unit), grad / size, direction, log_size, memory], 1)
    x = _layer(alpha, name, 0, x) + alpha[f"{name}.place"]
    x = _layer(alpha, name, 1, leaky_relu(x, LEAKY_RELU_SLOPE))
    x = _layer(alpha, name, 2, leaky_relu(x, LEAKY_RELU_SLOPE))
    moves, written = x.split([value.shape[1], MEMORY_CHANNELS], 1)
    return unit * moves, memory + written


def _layer(alpha: Params, name: str, i: int, x: Tensor) -> Tensor:
    """A 3x3 convolution of each task's channels by its own kernel; beyond the edges are zeros, or the other edge."""
    around = name.startswith("around.")
    x = pad(x, (1, 1, 0, 0), mode="circular") if around else x
    # task by task: of groups of such numbers of channels the library makes slow work
    pairs = zip(x.split(1), alpha[f"{name}.kernel{i}"], strict=True)
    convolved = torch.cat([conv2d(one, kernel, padding=(1, 0 if around else 1)) for one, kernel in pairs])
    return convolved + alpha[f"{name}.shift{i}"]
