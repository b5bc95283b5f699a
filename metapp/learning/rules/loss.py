"""Learned parameters of the inner loss, such as its smoothing, which an application may have."""

from __future__ import annotations

from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.rules.part import Part
from metapp.learning.task import Params


class LossParameters(Part):
    """The loss parameters `loss.<name>` [steps, ...] of an application; none where it has none.

    They go to the inner loss (`adjoint.loss_parameters`), so that this part says nothing about a step.
    """

    name = "loss"

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """As the application has them."""
        return {f"loss.{key}": value for key, value in app.loss_parameters(steps).items()}
