"""A closed-form step: recursive least squares for the layer that a network is linear in.

Bertinetto et al. 2019 ("Meta-learning with differentiable closed-form solvers", R2-D2) solve a ridge regression on
learned features and differentiate through it. Here each step adds the normal equations of its samples to the normal
equations of the steps before, and solves. The result of all steps is thus a ridge regression on all samples around the
initialisation. Sample weights may depend on the parameters so far, as the weights of a mean absolute error do.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor
from typing_extensions import override

from metapp.learning.adjoint import AnyBatch, Loss
from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.rules.rule import Part, StepInput
from metapp.learning.task import LeastSquares, Params

INITIAL_PENALTY = 1e-3  # penalty of each feature before training; Gram matrices of a step are means over samples
MIN_PENALTY, MAX_PENALTY = 1e-6, 1e2  # bounds of learned penalties
# rounding may lower eigenvalues of a Gram matrix by so many times its trace and the epsilon of its type
ROUNDING_FACTOR = 8


@dataclass(frozen=True)
class NormalEquations(Loss):
    """A loss whose steps see normal equations of a linear layer W [T, C, F] in place of a gradient.

    Attributes:
        linear: a function (params, batch, loss_parameters) -> least squares near the loss.
    """

    linear: Callable[[Params, AnyBatch, Params], LeastSquares] = field(kw_only=True)

    @override
    def gradient(
        self, theta: Params, batch: AnyBatch, loss_parameters: Params, *, graph: bool
    ) -> tuple[Params, Tensor]:
        """Return the normal equations by name in place of gradients, and the loss of each task, [T].

        Returns:
            Means over samples: `gram.<W>` [T, F, F] of products of features, and `moment.<W>` [T, C, F] of products of
            residuals and features. If the least squares have them, also `prior.<W>` [T, C, F] and `axes.<W>` [T, C, C].
        """
        with torch.set_grad_enabled(graph):
            linear = self.linear(theta, batch, loss_parameters)
            weighted = (linear.features * linear.weights[:, None] / linear.weights.shape[1]).mT
            gram, moment = linear.features @ weighted, linear.residual @ weighted
        sums = {f"gram.{linear.name}": gram, f"moment.{linear.name}": moment}
        axes = None if linear.axes is None else linear.axes.expand(len(gram), -1, -1)
        optional = {f"prior.{linear.name}": linear.prior, f"axes.{linear.name}": axes}
        return sums | {name: value for name, value in optional.items() if value is not None}, linear.losses.detach()


class Solve(Part):
    """Recursive least squares in the parameter W [T, C, F] that the network is linear in.

    Hyperparameters are `penalty.<W>` [1, C, F], logarithms of penalties, and `keep.<W>` [steps], logits of the share of
    earlier normal equations that a step keeps. With the Gram matrix G and the moments M of a step, P becomes keep P +
    G, and W becomes W + M (P + diag(exp(penalty)))^-1, each output by its own penalties. A prior of the least squares
    adds its precision to the penalties. Where the least squares have axes, the outputs are solved for along these.

    Penalties are at least the rounding error of P: in long training they fall, and without that bound the factorisation
    fails.
    """

    name = "solve"

    @override
    def refusal(self, app: App, theta: Params) -> str:
        return "" if app.linear_parameter else "its network is not linear in any parameter of one task"

    @override
    def initial(self, app: App, theta: Params, steps: int, adam: Adam) -> Params:
        """Return penalties of INITIAL_PENALTY for all features, and steps that keep nearly all earlier equations."""
        name = app.linear_parameter
        return {
            f"penalty.{name}": theta[name].new_full((1, *theta[name].shape), math.log(INITIAL_PENALTY)),
            f"keep.{name}": theta[name].new_full((steps,), 3.0),
        }

    @override
    def loss(self, app: App, loss: Loss) -> Loss:
        """Return a loss whose steps see the normal equations of the application's least squares."""
        return NormalEquations(loss.draw, loss.value, loss.shared, linear=app.least_squares)

    @override
    def state(self, alpha: Params, theta: Params) -> Params:
        """Return Gram matrices of 0, `gram.<W>` [T, F, F], for the sums over all samples so far."""
        names = _solved_names(alpha)
        return {f"gram.{key}": theta[key].new_zeros(len(theta[key]), *2 * theta[key].shape[-1:]) for key in names}

    @override
    def after_step(self, alpha: Params, theta: Params, before: StepInput, state: Params) -> tuple[Params, Params]:
        """Return W after the solve, and the Gram matrix of all samples so far."""
        results, grams = dict(theta), {}
        for key in _solved_names(alpha):
            keep = torch.sigmoid(alpha[f"keep.{key}"])[..., None, None]
            gram = grams[f"gram.{key}"] = keep * state[f"gram.{key}"] + before.grads[f"gram.{key}"]
            precision = torch.exp(alpha[f"penalty.{key}"].clamp(math.log(MIN_PENALTY), math.log(MAX_PENALTY)))
            trace = gram.diagonal(dim1=-2, dim2=-1).sum(-1)[:, None, None]
            precision = precision + ROUNDING_FACTOR * torch.finfo(gram.dtype).eps * trace
            # in double precision, as features are far from orthogonal
            precision, moment = precision.double(), before.grads[f"moment.{key}"].double()
            if f"prior.{key}" in before.grads:
                precision = precision + before.grads[f"prior.{key}"].double()
            axes = before.grads.get(f"axes.{key}", torch.eye(moment.shape[1])).to(moment)
            factors = torch.linalg.cholesky(gram.double()[:, None] + torch.diag_embed(precision))
            change = axes @ torch.cholesky_solve((axes.mT @ moment)[..., None], factors)[..., 0]
            results[key] = theta[key] + change.to(gram.dtype)
        return results, grams


def _solved_names(alpha: Params) -> list[str]:
    """Return the names of the parameters that have penalties."""
    return [name.removeprefix("penalty.") for name in alpha if name.startswith("penalty.")]
