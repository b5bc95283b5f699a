"""A learned eps of Adam: the size below which a gradient counts for less."""

from __future__ import annotations

import math

import torch

from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.rules.betas import Betas
from metapp.learning.rules.part import Part
from metapp.learning.task import Params


class Eps(Part):
    """The logarithm of Adam's eps, `eps` [1], which the part "betas" reads instead of its own."""

    name = "eps"
    beside = (Betas.name,)

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """The eps of `first`."""
        return {"eps": torch.tensor([math.log(first.eps)], dtype=torch.float64)}
