"""A closed-form step: recursive least squares for the layer that a network is linear in.

Bertinetto et al. 2019 ("Meta-learning with differentiable closed-form solvers", R2-D2) solve a ridge regression on
learned features and differentiate through it. Here each step adds its samples' normal equations to those of the steps
before and solves, so that the result of all steps is a ridge regression on all samples around the initialisation. The
weights of samples may depend on the parameters so far, as those of a mean absolute error do.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor

from metapp.learning.adjoint import AnyBatch, Loss
from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.rules.rule import Part, StepInput
from metapp.learning.task import LeastSquares, Params

INITIAL_PENALTY = 1e-3  # before training
MIN_PENALTY, MAX_PENALTY = 1e-6, 1e2  # bounds of learned penalties
ROUNDING_FACTOR = 8  # times the precision of a Gram matrix, of its trace: what rounding may take from its eigenvalues


@dataclass(frozen=True)
class NormalEquations(Loss):
    """A loss whose steps see normal equations in place of a gradient, near it and of a linear layer W [T, C, F].

    Attributes:
        linear: (params, batch, learned) -> least squares near the loss.
    """

    linear: Callable[[Params, AnyBatch, Params], LeastSquares] = field(kw_only=True)

    def gradient(self, theta: Params, batch: AnyBatch, learned: Params, *, graph: bool) -> tuple[Params, Tensor]:
        """Return means over samples: `gram.<W>` [T, F, F] of features, `moment.<W>` [T, C, F] of residuals, too.

        Beside them `prior.<W>` [T, C, F] and `axes.<W>` [T, C, C] if the least squares have these.
        """
        with torch.set_grad_enabled(graph):
            linear = self.linear(theta, batch, learned)
            weighted = (linear.features * linear.weights[:, None] / linear.weights.shape[1]).mT
            gram, moment = linear.features @ weighted, linear.residual @ weighted
        sums = {f"gram.{linear.name}": gram, f"moment.{linear.name}": moment}
        axes = None if linear.axes is None else linear.axes.expand(len(gram), -1, -1)
        beside = {f"prior.{linear.name}": linear.prior, f"axes.{linear.name}": axes}
        return sums | {name: value for name, value in beside.items() if value is not None}, linear.losses.detach()


def linear_parameter(app: App) -> str:
    """Return the name of the parameter [C, F] in which an application's network is linear; "" if there is none."""
    return str(getattr(app.network, "linear_parameter", ""))


class Solve(Part):
    """Least squares: `penalty.<W>` [1, C, F], logs of penalties, and `keep.<W>` [steps], logits of forgetting factors.

    With the normal equations G of a step (Gram matrix) and M (moments of residuals), P = keep P + G and
    W += M (P + diag(exp(penalty)))^-1, each output by its own penalties, and a prior of the least squares adds its
    precision to them. Where the least squares have axes, W moves along these. Penalties are at least the rounding
    error of P: longer training lets them fall, and without that bound the factorisation fails.
    """

    name = "solve"
    is_rate = True

    def refusal(self, app: App, theta: Params) -> str:
        """It needs a network that is linear in a parameter."""
        return "" if linear_parameter(app) else "its network is not linear in any parameter of one task"

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """Penalties of PENALTY for all features, and steps that keep nearly all of the ones before."""
        name = linear_parameter(app)
        return {
            f"penalty.{name}": theta[name].new_full((1, *theta[name].shape), math.log(INITIAL_PENALTY)),
            f"keep.{name}": theta[name].new_full((steps,), 3.0),
        }

    def loss(self, app: App, loss: Loss) -> Loss:
        """Normal equations of its least squares."""
        return NormalEquations(loss.draw, loss.value, loss.shared, linear=app.least_squares)

    def state(self, alpha: Params, theta: Params) -> Params:
        """The Gram matrix of all samples so far: none."""
        names = _names(alpha)
        return {f"gram.{key}": theta[key].new_zeros(len(theta[key]), *2 * theta[key].shape[-1:]) for key in names}

    def moved(self, alpha: Params, moved: Params, before: StepInput, state: Params) -> tuple[Params, Params]:
        """W after the solve, and the Gram matrix."""
        results, after = dict(moved), {}
        for key in _names(alpha):
            keep = torch.sigmoid(alpha[f"keep.{key}"])[..., None, None]
            gram = after[f"gram.{key}"] = keep * state[f"gram.{key}"] + before.grads[f"gram.{key}"]
            precision = torch.exp(alpha[f"penalty.{key}"].clamp(math.log(MIN_PENALTY), math.log(MAX_PENALTY)))
            trace = gram.diagonal(dim1=-2, dim2=-1).sum(-1)[:, None, None]
            precision = precision + ROUNDING_FACTOR * torch.finfo(gram.dtype).eps * trace
            # in double precision: features are far from orthogonal
            precision, moment = precision.double(), before.grads[f"moment.{key}"].double()
            if f"prior.{key}" in before.grads:
                precision = precision + before.grads[f"prior.{key}"].double()
            axes = before.grads.get(f"axes.{key}", torch.eye(moment.shape[1])).to(moment)
            factors = torch.linalg.cholesky(gram.double()[:, None] + torch.diag_embed(precision))
            change = axes @ torch.cholesky_solve((axes.mT @ moment)[..., None], factors)[..., 0]
            results[key] = moved[key] + change.to(gram.dtype)
        return results, after


def _names(alpha: Params) -> list[str]:
    return [name.removeprefix("penalty.") for name in alpha if name.startswith("penalty.")]
