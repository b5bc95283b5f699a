"""Curves on screens and in files."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from metapp.appearance.presentation import Picture, Presentation
from metapp.learning.task import Params, Task
from metapp_curve.app import SAMPLES, Curve


class CurvePresentation(Presentation[Curve]):
    """A curve as a plot of pixels."""

    title = "Curve"
    measure = "mean absolute difference at held-out samples"

    def outputs(self, theta: Params, task: Task) -> dict[str, Any]:
        """The curve and its fit, dark on white."""
        one = {key: value[None] for key, value in theta.items()}
        fitted = self.app.value(one, torch.linspace(-1, 1, SAMPLES)[None, None])[0, 0]
        return {"reference": _plot(task.data["y"].float()), "fit": _plot(fitted)}

    def files(self, theta: Params, task: Task) -> dict[str, Picture]:
        """The plot of the fit."""
        return {"curve": Picture(self.outputs(theta, task)["fit"], "data")}


def _plot(y: Tensor) -> Tensor:
    """Pixels [SAMPLES, SAMPLES, 3] of a curve within [-1, 1], upwards."""
    pixels = torch.ones(SAMPLES, SAMPLES, 3)
    rows = ((1 - y.clamp(-1, 1)) / 2 * (SAMPLES - 1)).round().long()
    pixels[rows, torch.arange(SAMPLES)] = 0.0
    return pixels
