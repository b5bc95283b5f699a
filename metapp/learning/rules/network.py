"""Learned gradient descent: a convolutional network adds to a rule's steps of parameters that lie on a grid.

The network reads the parameter, its gradient, the rule's direction and a memory of the steps before. Its output is
added to the rule's step (Adler & Oektem 2017; Putzky & Welling 2017). So it learns which changes of a texel's
neighbourhood a gradient calls for, where the loss alone leaves that open.

The network's weights are learned hyperparameters: `around.<parameter>.*` if the grid's columns continue at the opposite
edge, else `within.<parameter>.*`. Three layers have a `kernel` and a `shift` for each step; `place` is a shift for each
texel, which all steps share like the kernels, and `unit` the logarithm of the length in which moves are measured.
"""

from __future__ import annotations

import math

import torch
from torch import Generator, Tensor
from torch.nn.functional import conv2d, leaky_relu, pad
from typing_extensions import override

from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.rules.rule import Part, StepInput
from metapp.learning.task import Params

HIDDEN_CHANNELS = 32  # channels of the network's two inner layers
MEMORY_CHANNELS = 16  # channels of the memory from step to step
PARAMETER_UNIT_STEPS = 10  # the unit of the parameter as the network reads it, in lengths of a step
RULE_LEAKY_SLOPE = 0.1  # slope below 0 of the leaky ReLUs of the network


class StepNetwork(Part):
    """A convolutional network for each parameter of three axes, [channels, rows, columns]."""

    name = "network"

    @override
    def refusal(self, app: App, theta: Params) -> str:
        on_grid = any(value.ndim == 3 for value in theta.values())
        return "" if on_grid else "no parameter lies on a grid, which has three axes"

    @override
    def initial(self, app: App, theta: Params, steps: int, adam: Adam) -> Params:
        """Draw random inner layers; last layers are 0, so that a network adds nothing and leaves its memory empty.

        The network's moves are measured in the rate of `adam`, the length of the rule's own steps.
        """
        alpha: Params = {}
        rng = Generator().manual_seed(0)
        for key, value in theta.items():
            if value.ndim == 3:
                channels, name = len(value), f"{'around' if app.is_periodic else 'within'}.{key}"
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
                    f"{name}.unit": torch.full((1,), math.log(adam.rate)),
                }
        return alpha

    @override
    def state(self, alpha: Params, theta: Params) -> Params:
        """Return empty memories, `memory.<parameter>` [T, MEMORY_CHANNELS, rows, columns]."""
        return {
            f"memory.{key}": value.new_zeros(len(value), MEMORY_CHANNELS, *value.shape[2:])
            for key, value in theta.items()
            if _network_name(alpha, key)
        }

    @override
    def after_step(self, alpha: Params, theta: Params, before: StepInput, state: Params) -> tuple[Params, Params]:
        """Add the networks' outputs to the parameters, and return the new memories."""
        results, memories = dict(theta), {}
        for key, value in before.theta.items():
            if name := _network_name(alpha, key):
                memory = state[f"memory.{key}"]
                added, new_memory = _evaluate_network(
                    alpha, name, value, before.grads[key], before.directions[key], memory
                )
                results[key], memories[f"memory.{key}"] = theta[key] + added, new_memory
        return results, memories


def _network_name(alpha: Params, key: str) -> str:
    """Return the name of the network of a parameter in alpha; "" if the parameter has none."""
    return next((f"{edge}.{key}" for edge in ("around", "within") if f"{edge}.{key}.unit" in alpha), "")


def _evaluate_network(
    alpha: Params, name: str, value: Tensor, grad: Tensor, direction: Tensor, memory: Tensor
) -> tuple[Tensor, Tensor]:
    """Evaluate a network, and return what it adds to its parameter, and its new memory.

    Args:
        alpha: the hyperparameters of this step, with a task axis.
        name: the name of the network.
        value: the parameter [T, channels, rows, columns].
        grad: its gradient [T, channels, rows, columns]; the network reads it at length 1, and the logarithm of its
            length.
        direction: the rule's direction [T, channels, rows, columns], before any rate.
        memory: the network's memory of the steps before, [T, MEMORY_CHANNELS, rows, columns].

    Returns:
        The addition to the parameter [T, channels, rows, columns], and the memory after this step.
    """
    unit = torch.exp(alpha[f"{name}.unit"])[:, None, None, None]
    grad_length = (grad.square().mean((1, 2, 3), keepdim=True) + 1e-24).sqrt()
    log_length = 0.3 * grad_length.log().expand(-1, 1, *grad.shape[2:])
    features = torch.cat([value / (PARAMETER_UNIT_STEPS * unit), grad / grad_length, direction, log_length, memory], 1)
    features = _convolve(alpha, name, 0, features) + alpha[f"{name}.place"]
    features = _convolve(alpha, name, 1, leaky_relu(features, RULE_LEAKY_SLOPE))
    output = _convolve(alpha, name, 2, leaky_relu(features, RULE_LEAKY_SLOPE))
    moves, memory_change = output.split([value.shape[1], MEMORY_CHANNELS], 1)
    return unit * moves, memory + memory_change


def _convolve(alpha: Params, name: str, layer: int, features: Tensor) -> Tensor:
    """Convolve each task's channels [T, C, rows, columns] with kernels of 3x3 of that task, and add a shift.

    Outside the edges are zeros, or the texels of the opposite edge.
    """
    periodic = name.startswith("around.")
    features = pad(features, (1, 1, 0, 0), mode="circular") if periodic else features
    # task by task, as grouped convolutions of so few channels are slow in the library
    pairs = zip(features.split(1), alpha[f"{name}.kernel{layer}"], strict=True)
    convolved = torch.cat([conv2d(task, kernel, padding=(1, 0 if periodic else 1)) for task, kernel in pairs])
    return convolved + alpha[f"{name}.shift{layer}"]
