"""Plots of curves, as a user sees them in run folders and pages, and the export of curves as CSV."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor
from typing_extensions import override

from metapp.appearance.assets import Asset
from metapp.appearance.pictures import Picture
from metapp.appearance.presenter import Presenter
from metapp.learning.task import Params, Task, add_task_axis
from metapp_curve.app import SAMPLES, Curve


@dataclass(frozen=True, eq=False)
class Plot(Asset):
    """A curve, given by its values `y` at SAMPLES evenly spaced x, [SAMPLES] in [-1, 1]."""

    kind = "curve"
    y: Tensor

    @override
    def pictures(self) -> dict[str, Picture]:
        return {"curve": Picture(self.preview(), "data")}

    @override
    def preview(self) -> Tensor:
        """Draw the curve, dark on white, as pixels [SAMPLES, SAMPLES, 3]."""
        pixels = torch.ones(SAMPLES, SAMPLES, 3)
        rows = ((1 - self.y.clamp(-1, 1)) / 2 * (SAMPLES - 1)).round().long()
        pixels[rows, torch.arange(SAMPLES)] = 0.0
        return pixels


def make_plot(app: Curve, theta: Params, task: Task, size: tuple[int, int] | None) -> Plot:
    """Return the curve of a fit."""
    x = torch.linspace(-1, 1, SAMPLES)[None, None]
    return Plot(app.decoder.evaluate(add_task_axis(theta), x)[0, 0].detach())


def write_csv(asset: Plot, path: Path, provenance: Mapping[str, object]) -> None:
    """Write x and y of a curve, a pair a line, as <path>.csv."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pairs = zip(torch.linspace(-1, 1, SAMPLES).tolist(), asset.y.tolist(), strict=True)
    path.with_suffix(".csv").write_text("".join(f"{x:.6g},{y:.6g}\n" for x, y in pairs))


class CurvePresenter(Presenter[Curve]):
    """The presenter of curves: a fit beside the curve itself."""

    @override
    def reference(self, task: Task) -> Plot:
        return Plot(task.data["y"].float())
