"""A baseline of curves: the straight line by least squares."""

from __future__ import annotations

import torch
from torch import Generator
from typing_extensions import override

from metapp.extensions.baselines.baseline import Baseline, BaselineFit, CostLimits
from metapp.learning.app import App
from metapp.learning.task import Tasks


class Line(Baseline):
    """The straight line of least squares, which learns nothing from training tasks."""

    name = "line"
    title = "a straight line by least squares"
    cannot = "bend"

    @override
    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        """Fit the line to the visible samples of one task; two numbers are stored."""
        x, y = (tasks.data[key][tasks.rows][0] for key in ("x", "y"))
        columns = torch.stack([x, torch.ones_like(x)], 1)
        coefficients = torch.linalg.lstsq(columns[::2], y[::2, None]).solution
        return BaselineFit(lambda: (columns[1::2] @ coefficients).T[None], 2, 8)


def baselines(app: App) -> tuple[Baseline, ...]:
    """Return the baselines of curves."""
    return (Line(app),)
