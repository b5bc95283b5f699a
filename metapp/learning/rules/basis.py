"""The eigenbasis of gradients, where Adam's entries depend least on each other.

That is SOAP (Vyas et al. 2024), but for axes that are learned once, on the training tasks, not anew in each fit, which
has no time for it.
"""

from __future__ import annotations

import torch
from torch import Tensor

from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.rules.part import Part
from metapp.learning.task import Params

EQUATIONS = {"out": "{0}ji,{0}j...->{0}i...", "in": "{0}ji,{0}kj...->{0}ki..."}


class Basis(Part):
    """Bases of the first two axes of each parameter: `out.<parameter>`, `in.<parameter>` [1, size, size].

    Gradients are turned to them, and updates back: rates are of the axes that bases turn to.
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
            for axis, size in zip(EQUATIONS, value.shape[:2], strict=True)
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
            if axis in EQUATIONS:
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
    for name, equation in EQUATIONS.items():
        if f"{name}.{key}" in alpha:
            basis = alpha[f"{name}.{key}"]
            terms = equation.format("t" if basis.ndim == 3 else "")  # where there is a task axis
            value = torch.einsum(terms, basis.mT if back else basis, value)
    return value
