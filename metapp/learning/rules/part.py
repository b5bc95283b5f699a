"""A part of a learned rule: its hyperparameters, and its action at each point of a step."""

from __future__ import annotations

from typing import NamedTuple

from metapp.learning.adjoint import Loss
from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.task import Params


class Before(NamedTuple):
    """The state of a step before it moves: trees of the same names, tensors [T, ...].

    Attributes:
        theta: the parameters.
        grads: their gradients, as the loss gave them.
        directions: what all parts made of these, before any rate.
    """

    theta: Params
    grads: Params
    directions: Params


class Part:
    """A part of a learned rule; what it has nothing to say about stays as it is.

    A step passes the gradients through `gradients` of all parts, then through their `directions`, then through their
    `updates`, which are subtracted, and the parameters that this gives through their `moved`. Wherever a step is
    concerned, `alpha` holds the hyperparameters of that step, with a task axis.

    Attributes:
        name: in compositions, such as "adam+curvature".
        is_rate: whether it says how far parameters move: of such parts a rule has one.
        beside: names of parts; a rule that has this part must have one of them, if there are any.
        settled: what names of hyperparameters begin with that it takes from gradients of training tasks, before the
            outer loop and before any search of an Adam.
    """

    name: str
    is_rate: bool = False
    beside: tuple[str, ...] = ()
    settled: tuple[str, ...] = ()

    def refusal(self, app: App, theta: Params) -> str:
        """Why it does not apply to an application with these parameters of one task; "" where it does."""
        return ""

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """Hyperparameters [K, ...] before training, those of the plain Adam `first` where it has them.

        Args:
            app: the application.
            theta: parameters of one task.
            steps: of a fit; K is this, or 1 for what is the same at all steps.
            first: settings of an Adam.
        """
        return {}

    def loss(self, app: App, loss: Loss) -> Loss:
        """The loss that steps descend, of the application's own."""
        return loss

    def state(self, alpha: Params, theta: Params) -> Params:
        """The memory that it keeps from step to step, before the first one; `theta` has a task axis."""
        return {}

    def gradients(self, alpha: Params, grads: Params) -> Params:
        """Transform the gradients."""
        return grads

    def directions(self, alpha: Params, directions: Params, state: Params) -> tuple[Params, Params]:
        """Transform the directions, and return its memory with them."""
        return directions, {}

    def updates(self, alpha: Params, updates: Params) -> Params:
        """Transform the updates, the directions at first; they are subtracted from the parameters."""
        return updates

    def moved(self, alpha: Params, moved: Params, before: Before, state: Params) -> tuple[Params, Params]:
        """Transform the parameters after the step, and return its memory with them."""
        return moved, {}

    def for_steps(self, alpha: Params, steps: int) -> Params:
        """Alpha [K, ...] for a fit of so many steps, whatever it was prepared for."""
        return alpha

    def gather(self, alpha: Params, grads: Params) -> Params:
        """Statistics of the gradients [T, ...] of a step on training tasks, which are summed over steps."""
        return {}

    def settle(self, alpha: Params, sums: Params) -> Params:
        """Alpha [K, ...] with what these sums say."""
        return alpha
