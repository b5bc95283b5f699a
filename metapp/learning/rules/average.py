"""Tail averaging: the mean of the last parameters as the result, where random samples scatter them."""

from __future__ import annotations

import torch

from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.rules.descent import like
from metapp.learning.rules.part import Before, Part
from metapp.learning.task import Params

AVERAGED = 0.4  # of the steps


class Average(Part):
    """A running mean of the parameters: `mean` [steps], the new ones' weight in it; `answer`, its own in the result."""

    name = "average"

    def refusal(self, app: App, theta: Params) -> str:
        """It needs samples that scatter the parameters."""
        return "its fits see nothing random that would scatter the parameters" if app.traits.deterministic else ""

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """Tail averaging over AVERAGED of the steps."""
        return averaging(steps)

    def state(self, alpha: Params, theta: Params) -> Params:
        """The mean, which the first parameters replace."""
        # not theta: derivatives are not carried through a state's first values, which the first mean forgets anyway
        return {f"mean.{key}": torch.zeros_like(value) for key, value in theta.items()}

    def moved(self, alpha: Params, moved: Params, before: Before, state: Params) -> tuple[Params, Params]:
        """The parameters, or the mean at the last step."""
        means, results = {}, {}
        for key, value in moved.items():
            last = state[f"mean.{key}"]
            mean = means[f"mean.{key}"] = torch.lerp(last, value, like(alpha["mean"], last))
            results[key] = torch.lerp(value, mean, like(alpha["answer"], last))
        return results, means

    def for_steps(self, alpha: Params, steps: int) -> Params:
        """The mean is over the last of the steps, however many they are."""
        return alpha | {name: value.to(alpha[name]) for name, value in averaging(steps).items()}


def averaging(steps: int) -> Params:
    """`mean` and `answer` [steps]: the last step gives the running mean over the last AVERAGED of the steps."""
    after = torch.arange(steps) - round((1 - AVERAGED) * steps)
    return {
        "mean": 1 / (1 + after).clamp_min(1),
        "answer": (torch.arange(steps) == steps - 1).float(),
    }
