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


@dataclass(frozen=True, eq=False)
class Plot(Asset):
    """A curve, given by its values `y` in [-1, 1] at evenly spaced x, [N]."""

    kind = "curve"
    y: Tensor

    @override
    def pictures(self) -> dict[str, Picture]:
        return {"curve": Picture(self.preview(), "data")}

    @override
    def preview(self) -> Tensor:
        """Draw the curve, dark on white, as pixels [N, N, 3]."""
        side = len(self.y)
        pixels = torch.ones(side, side, 3)
        pixels[((1 - self.y.clamp(-1, 1)) / 2 * (side - 1)).round().long(), torch.arange(side)] = 0.0
        return pixels


def write_csv(asset: Plot, path: Path, provenance: Mapping[str, object]) -> None:
    """Write x and y of a curve, a pair a line, as <path>.csv."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pairs = zip(torch.linspace(-1, 1, len(asset.y)).tolist(), asset.y.tolist(), strict=True)
    path.with_suffix(".csv").write_text("".join(f"{x:.6g},{y:.6g}\n" for x, y in pairs))
