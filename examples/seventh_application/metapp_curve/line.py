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
        names = ("x", "y", "held_out_x")
        x, y, held_out_x = (tasks.data[name][tasks.rows][0, 0] for name in names)
        coefficients = torch.linalg.lstsq(torch.stack([x, torch.ones_like(x)], 1), y[:, None]).solution
        columns = torch.stack([held_out_x, torch.ones_like(held_out_x)], 1)
        return BaselineFit(lambda: (columns @ coefficients).T[None], 2, 8)


def baselines(app: App) -> tuple[Baseline, ...]:
    """Return the baselines of curves."""
    return (Line(app),)
