"""What people look at of fitted curves: plots."""

from __future__ import annotations

import torch
from torch import Tensor

from metapp.appearance.pictures import Picture
from metapp.appearance.presenter import Presenter
from metapp.learning.task import Params, Task
from metapp_curve.app import SAMPLES, Curve


class CurvePresenter(Presenter[Curve]):
    """What people look at of a fitted curve."""

    def preview(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Draw the curve and its fit, dark on white."""
        parameters = {key: value[None] for key, value in theta.items()}
        fitted = self.app.value(parameters, torch.linspace(-1, 1, SAMPLES)[None, None])[0, 0]
        return {"reference": plot(task.data["y"].float()), "fit": plot(fitted)}

    def pictures(self, theta: Params, task: Task) -> dict[str, Picture]:
        """Draw the fit as a file."""
        return {"curve": Picture(self.preview(theta, task)["fit"], "data")}


def plot(y: Tensor) -> Tensor:
    """Draw a curve within [-1, 1], upwards, as pixels [SAMPLES, SAMPLES, 3]."""
    pixels = torch.ones(SAMPLES, SAMPLES, 3)
    rows = ((1 - y.clamp(-1, 1)) / 2 * (SAMPLES - 1)).round().long()
    pixels[rows, torch.arange(SAMPLES)] = 0.0
    return pixels
