"""The parts of learned rules that take a few lines each.

Each class says which hyperparameters it has, under which names, and what they do to a step. The two large parts are in
:mod:`metapp.learning.rules.network` and :mod:`metapp.learning.rules.solve`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor
from typing_extensions import override

from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.rules.descent import adam_directions, adam_state, append_axes, half_cosine
from metapp.learning.rules.rule import Part, StepInput
from metapp.learning.task import Params

META_EPS = 1e-6  # Adam's eps in rules that do not learn it
TAIL_SHARE = 0.4  # the share of the steps whose parameters tail averaging averages
# einsum of a basis and a gradient, by the axis that the basis rotates; {0} is the task axis
BASIS_EQUATIONS = {"out": "{0}ji,{0}j...->{0}i...", "in": "{0}ji,{0}kj...->{0}ki..."}


@dataclass(frozen=True)
class Rates(Part):
    """A rate (step size) for each weight, `rate.<parameter>`.

    Attributes:
        form: how steps share rates.

            - "signed": all steps have equal rates [1, ...], of any sign (Meta-SGD, Li et al. 2017).
            - "stepwise": each step has rates of its own; the logarithms are learned, [steps, ...].
            - "paced": all steps have equal rates, whose logarithms [1, ...] are learned, times a factor for each
              parameter tensor and step, whose logarithms are `pace.<parameter>` [steps]. A rule is then nearly as small
              as one of signed rates.
    """

    form: Literal["signed", "stepwise", "paced"] = "stepwise"

    name = "rates"

    @override
    def initial(self, app: App, theta: Params, steps: int, adam: Adam) -> Params:
        """Return the half cosine of `adam` for all weights; signed rates are the first rate of `adam`."""
        if self.form == "signed":
            return {f"rate.{key}": torch.full_like(value, adam.rate)[None] for key, value in theta.items()}
        rates = half_cosine(adam.rate, steps, adam.final_rate_share).log()
        alpha = {f"rate.{key}": append_axes(rates, value[None]).repeat(1, *value.shape) for key, value in theta.items()}
        if self.form == "stepwise":
            return alpha
        paces = half_cosine(1.0, steps, adam.final_rate_share).log()
        return {key: value[:1] for key, value in alpha.items()} | {f"pace.{key}": paces.clone() for key in theta}

    @override
    def updates(self, alpha: Params, updates: Params) -> Params:
        """Multiply the updates by their rates; parameters without a rate get no update."""
        with_rate = {key: update for key, update in updates.items() if f"rate.{key}" in alpha}
        return {key: append_axes(self._rate(alpha, key), update) * update for key, update in with_rate.items()}

    def _rate(self, alpha: Params, key: str) -> Tensor:
        """Return the rates of a parameter at one step."""
        rate = alpha[f"rate.{key}"]
        if self.form == "paced":
            rate = rate + append_axes(alpha[f"pace.{key}"], rate)
        return rate if self.form == "signed" else torch.exp(rate)


@dataclass(frozen=True)
class AdamDirections(Part):
    """Adam's moments and normalised directions; `beta1` and `beta2` [steps] hold the logits of its decay factors.

    Attributes:
        learns_eps: whether `eps` [1] holds the logarithm of Adam's eps, which is learned; else eps is META_EPS.
    """

    learns_eps: bool = False

    name = "adam"

    @override
    def initial(self, app: App, theta: Params, steps: int, adam: Adam) -> Params:
        """Return the decay factors of `adam` for all steps, and its eps."""
        betas = {"beta1": adam.beta1, "beta2": adam.beta2}
        alpha = {name: torch.full((steps,), math.log(beta / (1 - beta))) for name, beta in betas.items()}
        eps = {"eps": torch.tensor([math.log(adam.eps)], dtype=torch.float64)}
        return alpha | (eps if self.learns_eps else {})

    @override
    def state(self, alpha: Params, theta: Params) -> Params:
        """Return moments of 0. See :func:`metapp.learning.rules.descent.adam_state`."""
        return adam_state(theta)

    @override
    def directions(self, alpha: Params, directions: Params, state: Params) -> tuple[Params, Params]:
        """Replace gradients by Adam's normalised directions, and return the new moments."""
        beta1, beta2 = torch.sigmoid(alpha["beta1"]), torch.sigmoid(alpha["beta2"])
        eps = torch.exp(alpha["eps"]) if self.learns_eps else META_EPS
        return adam_directions(beta1, beta2, eps, directions, state)


class LossParameters(Part):
    """The loss parameters of an application, `loss.<name>` [steps, ...], if it has any.

    The inner loss reads them (see :func:`metapp.learning.adjoint.select_loss_parameters`), so that this part changes
    nothing else about a step.
    """

    name = "loss"

    @override
    def initial(self, app: App, theta: Params, steps: int, adam: Adam) -> Params:
        """Return the initial values that the application gives its loss parameters."""
        return {f"loss.{key}": value for key, value in app.initial_loss_parameters(steps).items()}


class Curvature(Part):
    """Matrices that mix the directions of a layer: Meta-Curvature (Park & Oliva 2019).

    For each parameter of two axes, `left.<parameter>` and `right.<parameter>` [steps, size, size] multiply its
    direction from both sides.
    """

    name = "curvature"

    @override
    def refusal(self, app: App, theta: Params) -> str:
        return "" if any(_matrix_sizes(value) for value in theta.values()) else "no parameter has two axes"

    @override
    def initial(self, app: App, theta: Params, steps: int, adam: Adam) -> Params:
        """Return identity matrices for all axes of more than one entry."""
        return {
            f"{side}.{key}": torch.eye(size).repeat(steps, 1, 1)
            for key, value in theta.items()
            for side, size in _matrix_sizes(value).items()
        }

    @override
    def directions(self, alpha: Params, directions: Params, state: Params) -> tuple[Params, Params]:
        """Multiply each direction by its left and its right matrix."""
        return {key: _mix_direction(alpha, key, direction) for key, direction in directions.items()}, {}


def _matrix_sizes(value: Tensor) -> dict[str, int]:
    """Return the sizes of the left and the right matrix of a parameter of one task, by side; {} if it has none."""
    sides = zip(("left", "right"), value.shape, strict=True) if value.ndim == 2 else ()
    return {side: size for side, size in sides if size > 1}


def _mix_direction(alpha: Params, key: str, direction: Tensor) -> Tensor:
    """Multiply a direction by the left and the right matrix of its parameter, where there are such."""
    if f"left.{key}" in alpha:
        direction = alpha[f"left.{key}"] @ direction
    if f"right.{key}" in alpha:
        direction = direction @ alpha[f"right.{key}"]
    return direction


class Average(Part):
    """Tail averaging: the result of a fit is the mean of its last parameters, for losses of random samples.

    `mean` [steps] is the weight of a step's parameters in the running mean. `answer` [steps] is the weight of the
    running mean in the parameters that the step returns.
    """

    name = "average"

    @override
    def refusal(self, app: App, theta: Params) -> str:
        return "its fits see nothing random that would scatter the parameters" if app.deterministic else ""

    @override
    def initial(self, app: App, theta: Params, steps: int, adam: Adam) -> Params:
        """Return weights that average the last TAIL_SHARE of the steps."""
        return tail_averaging_weights(steps)

    @override
    def state(self, alpha: Params, theta: Params) -> Params:
        """Return means of 0, which the first parameters replace."""
        # not theta: derivatives do not flow through the first state, and the first weight of 1 replaces the mean anyway
        return {f"mean.{key}": torch.zeros_like(value) for key, value in theta.items()}

    @override
    def after_step(self, alpha: Params, theta: Params, before: StepInput, state: Params) -> tuple[Params, Params]:
        """Update the running mean, and return it in place of the parameters at the last step."""
        means, results = {}, {}
        for key, value in theta.items():
            old_mean = state[f"mean.{key}"]
            mean = means[f"mean.{key}"] = torch.lerp(old_mean, value, append_axes(alpha["mean"], old_mean))
            results[key] = torch.lerp(value, mean, append_axes(alpha["answer"], old_mean))
        return results, means

    @override
    def for_steps(self, alpha: Params, steps: int) -> Params:
        """Return weights that average the last TAIL_SHARE of these steps."""
        return alpha | {name: value.to(alpha[name]) for name, value in tail_averaging_weights(steps).items()}


def tail_averaging_weights(steps: int) -> Params:
    """Return `mean` and `answer` [steps], by which the last step returns the mean over the last of the steps.

    TAIL_SHARE is the share of the steps that the mean is taken over.
    """
    step_of_tail = torch.arange(steps) - round((1 - TAIL_SHARE) * steps)
    return {
        "mean": 1 / (1 + step_of_tail).clamp_min(1),
        "answer": (torch.arange(steps) == steps - 1).float(),
    }


class Basis(Part):
    """The eigenbasis of gradients, in which the entries that Adam scales depend least on each other.

    `out.<parameter>` and `in.<parameter>` [1, size, size] are orthonormal bases of the first two axes of a parameter.
    Gradients are rotated into them and updates back, so that rates belong to the axes of the bases. This is SOAP (Vyas
    et al. 2024), except that the bases are found once, on the training tasks: a fit of a few steps has no time to find
    them.
    """

    name = "basis"
    statistics_prefixes = ("out.", "in.")

    @override
    def refusal(self, app: App, theta: Params) -> str:
        return "" if any(value.ndim > 1 for value in theta.values()) else "no parameter has two axes"

    @override
    def initial(self, app: App, theta: Params, steps: int, adam: Adam) -> Params:
        """Return identity matrices, until :meth:`from_statistics` replaces them."""
        return {
            f"{axis}.{key}": torch.eye(size)[None]
            for key, value in theta.items()
            if value.ndim > 1
            for axis, size in zip(BASIS_EQUATIONS, value.shape[:2], strict=True)
        }

    @override
    def gradients(self, alpha: Params, grads: Params) -> Params:
        """Rotate gradients into the bases."""
        return {key: _rotate(alpha, key, grad) for key, grad in grads.items()}

    @override
    def updates(self, alpha: Params, updates: Params) -> Params:
        """Rotate updates back from the bases."""
        return {key: _rotate(alpha, key, update, back=True) for key, update in updates.items()}

    @override
    def gradient_statistics(self, alpha: Params, grads: Params) -> Params:
        """Return sums of products of gradients [T, out, in, ...] along the axis of each basis, [size, size].

        Each gradient is scaled to length 1, so that all tasks weigh alike.
        """
        moments = {}
        for name in alpha:
            axis, _, key = name.partition(".")
            if axis in BASIS_EQUATIONS:
                length = grads[key].flatten(1).norm(dim=1).clamp_min(1e-20)
                unit = grads[key] / length.reshape(-1, *[1] * (grads[key].ndim - 1))
                rows = unit.movedim(1 if axis == "out" else 2, 0).flatten(1)
                moments[name] = rows @ rows.mT
        return moments

    @override
    def from_statistics(self, alpha: Params, sums: Params) -> Params:
        """Replace the bases by the principal axes of gradients."""
        return alpha | {name: torch.linalg.eigh(value).eigenvectors[None] for name, value in sums.items()}


def _rotate(alpha: Params, key: str, value: Tensor, *, back: bool = False) -> Tensor:
    """Rotate a gradient [T, out, in, ...] into the bases of its parameter, or an update back from them."""
    for name, equation in BASIS_EQUATIONS.items():
        if f"{name}.{key}" in alpha:
            basis = alpha[f"{name}.{key}"]
            terms = equation.format("t" if basis.ndim == 3 else "")  # with or without a task axis
            value = torch.einsum(terms, basis.mT if back else basis, value)
    return value
