"""Pictures of fitted curves: plots, as a user sees them in run folders and pages."""

from __future__ import annotations

import torch
from torch import Tensor
from typing_extensions import override

from metapp.appearance.pictures import Picture
from metapp.appearance.presenter import Presenter
from metapp.learning.task import Params, Task, add_task_axis
from metapp_curve.app import SAMPLES, Curve


class CurvePresenter(Presenter[Curve]):
    """The presenter of curves: a plot of the curve and one of its fit."""

    @override
    def preview(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Draw the curve and its fit, dark on white."""
        parameters = add_task_axis(theta)
        fitted = self.app.decoder.evaluate(parameters, torch.linspace(-1, 1, SAMPLES)[None, None])[0, 0]
        return {"reference": plot(task.data["y"].float()), "fit": plot(fitted)}

    @override
    def pictures(self, theta: Params, task: Task) -> dict[str, Picture]:
        """Draw the fit as a file."""
        return {"curve": Picture(self.preview(theta, task)["fit"], "data")}


def plot(y: Tensor) -> Tensor:
    """Draw a curve [SAMPLES] with values in [-1, 1], dark on white, as pixels [SAMPLES, SAMPLES, 3]."""
    pixels = torch.ones(SAMPLES, SAMPLES, 3)
    rows = ((1 - y.clamp(-1, 1)) / 2 * (SAMPLES - 1)).round().long()
    pixels[rows, torch.arange(SAMPLES)] = 0.0
    return pixels
