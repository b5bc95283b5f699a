"""The parts of learned rules that are a few lines each; `network` and `solve` are beside them."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.rules.descent import adam_directions, adam_state, append_axes, half_cosine
from metapp.learning.rules.rule import Part, StepInput
from metapp.learning.task import Params

META_EPS = 1e-6  # of rules without the part "eps"
TAIL_SHARE = 0.4  # of the steps, by tail averaging
BASIS_EQUATIONS = {"out": "{0}ji,{0}j...->{0}i...", "in": "{0}ji,{0}kj...->{0}ki..."}  # of bases


class SignedRates(Part):
    """One rate per weight, the same at every step, of any sign: `rate.<parameter>` [1, ...] (Li et al. 2017)."""

    name = "sgd"
    is_rate = True

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """The rate of `first` for all."""
        return {f"rate.{key}": torch.full_like(value, first.rate)[None] for key, value in theta.items()}

    def updates(self, alpha: Params, updates: Params) -> Params:
        """Rate times update; parameters without a rate stay."""
        return {
            key: append_axes(alpha[f"rate.{key}"], up) * up for key, up in updates.items() if f"rate.{key}" in alpha
        }


class Rates(Part):
    """The logarithm of a rate per weight and step: `rate.<parameter>` [steps, ...]."""

    name = "rates"
    is_rate = True

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """The half cosine of `first` for all."""
        rates = half_cosine(first.rate, steps, first.final).log()
        return {f"rate.{key}": append_axes(rates, value[None]).repeat(1, *value.shape) for key, value in theta.items()}

    def updates(self, alpha: Params, updates: Params) -> Params:
        """Rate times update; the logarithms of rate and pace, if there is one, add up. No rate: no update."""
        rated = {key: update for key, update in updates.items() if f"rate.{key}" in alpha}
        return {key: append_axes(torch.exp(_logarithm(alpha, key)), update) * update for key, update in rated.items()}


class SharedRates(Rates):
    """The logarithm of a rate per weight, the same at every step: `rate.<parameter>` [1, ...]."""

    name = "shared"

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """The first rate of `first` for all."""
        return {key: value[:1] for key, value in super().initial(app, theta, steps, first).items()}


class Paces(Part):
    """The logarithm of a factor per parameter tensor and step: `pace.<parameter>` [steps].

    With shared rates, a rule is as small as one of signed rates: "tied".
    """

    name = "pace"
    needs_one_of = (Rates.name, SharedRates.name)

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """The half cosine of `first`, relative to its first rate."""
        paces = half_cosine(1.0, steps, first.final).log()
        return {f"pace.{key}": paces.clone() for key in theta}


def _logarithm(alpha: Params, key: str) -> Tensor:
    rate = alpha[f"rate.{key}"]
    return rate + append_axes(alpha[f"pace.{key}"], rate) if f"pace.{key}" in alpha else rate


class Betas(Part):
    """Adam's moments and normalised directions; `beta1` and `beta2` [steps] hold the logits of its betas."""

    name = "betas"

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """The betas of `first` at every step."""
        betas = {"beta1": first.beta1, "beta2": first.beta2}
        return {name: torch.full((steps,), math.log(beta / (1 - beta))) for name, beta in betas.items()}

    def state(self, alpha: Params, theta: Params) -> Params:
        """Both moments, 0."""
        return adam_state(theta)

    def directions(self, alpha: Params, directions: Params, state: Params) -> tuple[Params, Params]:
        """Adam's directions."""
        beta1, beta2 = torch.sigmoid(alpha["beta1"]), torch.sigmoid(alpha["beta2"])
        eps = torch.exp(alpha["eps"]) if "eps" in alpha else META_EPS
        return adam_directions(beta1, beta2, eps, directions, state)


class Eps(Part):
    """The logarithm of Adam's eps, `eps` [1], which the part "betas" reads instead of its own."""

    name = "eps"
    needs_one_of = (Betas.name,)

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """The eps of `first`."""
        return {"eps": torch.tensor([math.log(first.eps)], dtype=torch.float64)}


class LossParameters(Part):
    """The loss parameters `loss.<name>` [steps, ...] of an application, if it has any.

    They go to the inner loss (`adjoint.loss_parameters`), so that this part says nothing about a step.
    """

    name = "loss"

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """As the application has them."""
        return {f"loss.{key}": value for key, value in app.loss_parameters(steps).items()}


class Curvature(Part):
    """Matrices that mix a layer's directions: Meta-Curvature (Park & Oliva 2019).

    `left.<parameter>`, `right.<parameter>`, per step, are on both sides of each parameter of two axes.
    """

    name = "curvature"

    def refusal(self, app: App, theta: Params) -> str:
        """It needs a matrix."""
        return "" if any(_sides(value) for value in theta.values()) else "no parameter has two axes"

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """The identity, [steps, size, size], for each axis of more than one entry."""
        return {
            f"{side}.{key}": torch.eye(size).repeat(steps, 1, 1)
            for key, value in theta.items()
            for side, size in _sides(value).items()
        }

    def directions(self, alpha: Params, directions: Params, state: Params) -> tuple[Params, Params]:
        """Left matrix times direction times right matrix."""
        return {key: _mixed(alpha, key, direction) for key, direction in directions.items()}, {}


def _sides(value: Tensor) -> dict[str, int]:
    """The sizes of a parameter's matrices, of one task."""
    sides = zip(("left", "right"), value.shape, strict=True) if value.ndim == 2 else ()
    return {side: size for side, size in sides if size > 1}


def _mixed(alpha: Params, key: str, direction: Tensor) -> Tensor:
    if f"left.{key}" in alpha:
        direction = alpha[f"left.{key}"] @ direction
    if f"right.{key}" in alpha:
        direction = direction @ alpha[f"right.{key}"]
    return direction


class Average(Part):
    """Tail averaging: the mean of the last parameters as the result, for losses of random samples.

    `mean` [steps] is the new parameters' weight in the running mean; `answer` is the mean's own in the result.
    """

    name = "average"

    def refusal(self, app: App, theta: Params) -> str:
        """It needs samples that scatter the parameters."""
        return "its fits see nothing random that would scatter the parameters" if app.deterministic else ""

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """Tail averaging over AVERAGED of the steps."""
        return tail_averaging_weights(steps)

    def state(self, alpha: Params, theta: Params) -> Params:
        """The mean, which the first parameters replace."""
        # not theta: derivatives are not carried through a state's first values, which the first mean forgets anyway
        return {f"mean.{key}": torch.zeros_like(value) for key, value in theta.items()}

    def moved(self, alpha: Params, moved: Params, before: StepInput, state: Params) -> tuple[Params, Params]:
        """The parameters, or the mean at the last step."""
        means, results = {}, {}
        for key, value in moved.items():
            last = state[f"mean.{key}"]
            mean = means[f"mean.{key}"] = torch.lerp(last, value, append_axes(alpha["mean"], last))
            results[key] = torch.lerp(value, mean, append_axes(alpha["answer"], last))
        return results, means

    def for_steps(self, alpha: Params, steps: int) -> Params:
        """The mean is over the last of the steps, however many they are."""
        return alpha | {name: value.to(alpha[name]) for name, value in tail_averaging_weights(steps).items()}


def tail_averaging_weights(steps: int) -> Params:
    """`mean` and `answer` [steps]: the last step gives the running mean over the last AVERAGED of the steps."""
    after = torch.arange(steps) - round((1 - TAIL_SHARE) * steps)
    return {
        "mean": 1 / (1 + after).clamp_min(1),
        "answer": (torch.arange(steps) == steps - 1).float(),
    }


class Basis(Part):
    """The eigenbasis of gradients, in which Adam's entries depend least on each other.

    `out.<parameter>`, `in.<parameter>` [1, size, size] are bases of a parameter's first two axes. Gradients are turned
    to them, and updates back: rates are of the axes that bases turn to. That is SOAP (Vyas et al. 2024), but for axes
    that are learned once, on the training tasks, not anew in each fit, which has no time for it.
    """

    name = "basis"
    settled = ("out.", "in.")

    def refusal(self, app: App, theta: Params) -> str:
        """It needs a matrix, of however many further axes."""
        return "" if any(value.ndim > 1 for value in theta.values()) else "no parameter has two axes"

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """The identity."""
        return {
            f"{axis}.{key}": torch.eye(size)[None]
            for key, value in theta.items()
            if value.ndim > 1
            for axis, size in zip(BASIS_EQUATIONS, value.shape[:2], strict=True)
        }

    def gradients(self, alpha: Params, grads: Params) -> Params:
        """Gradients in the bases."""
        return {key: _rotated(alpha, key, grad) for key, grad in grads.items()}

    def updates(self, alpha: Params, updates: Params) -> Params:
        """Updates back from the bases."""
        return {key: _rotated(alpha, key, update, back=True) for key, update in updates.items()}

    def gather(self, alpha: Params, grads: Params) -> Params:
        """Sums of products of gradients [T, out, in, ...] for each basis, [size, size].

        Each gradient is brought to length 1, so that tasks weigh alike.
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

    def settle(self, alpha: Params, sums: Params) -> Params:
        """Alpha with its bases turned to the principal axes of gradients."""
        return alpha | {name: torch.linalg.eigh(value).eigenvectors[None] for name, value in sums.items()}


def _rotated(alpha: Params, key: str, value: Tensor, *, back: bool = False) -> Tensor:
    """A gradient [T, out, in, ...] in the bases that alpha holds for its first two axes, or back from there."""
    for name, equation in BASIS_EQUATIONS.items():
        if f"{name}.{key}" in alpha:
            basis = alpha[f"{name}.{key}"]
            terms = equation.format("t" if basis.ndim == 3 else "")  # where there is a task axis
            value = torch.einsum(terms, basis.mT if back else basis, value)
    return value
