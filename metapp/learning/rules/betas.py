"""Adam's moments, with learned betas."""

from __future__ import annotations

import math

import torch

from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.rules.descent import adam_directions, adam_state
from metapp.learning.rules.part import Part
from metapp.learning.task import Params

META_EPS = 1e-6  # of rules without the part "eps"


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
