"""Directions to measure, seen from above: where the light is, where the detector, in which order."""

from __future__ import annotations

import math

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes
from torch import Tensor

from metapp.evaluation.style import COLOURS, INK, MUTED, STYLE, Drawn

NUMBERED = 32  # pairs up to which each has its number


def directions(wi: Tensor, wo: Tensor, before: tuple[Tensor, Tensor], maps: tuple[Tensor, Tensor]) -> Drawn:
    """Pairs of directions to measure, and what they leave open.

    Args:
        wi, wo: unit vectors [N, 3] to light and detector, z the normal.
        before: those of what was measured before.
        maps: expected errors x100 before and after them, over half and difference angles from 0 to 90 degrees.
    """
    with rc_context(STYLE):
        figure = Figure(figsize=(8.6, 5.2), layout="constrained")
        places = figure.subplot_mosaic(
            [["pairs", "before"], ["pairs", "after"]],
            width_ratios=[1.7, 1],
            per_subplot_kw={"pairs": {"projection": "polar"}},
        )
        axis = places["pairs"]
        assert isinstance(axis, PolarAxes)
        _errors(figure, [places["before"], places["after"]], maps)
        axis.set_rlim(0, 90)
        axis.set_rticks([30, 60, 90], ["30", "60", "90 degrees"])
        axis.set_thetagrids(range(0, 360, 45))
        for light, detector in zip(*before, strict=True):
            _pair(axis, light, detector, MUTED, "")
        for at, (light, detector) in enumerate(zip(wi, wo, strict=True), 1):
            _pair(axis, light, detector, COLOURS["meta"], str(at) if len(wi) <= NUMBERED else "")
        axis.plot([], [], "o", color=COLOURS["meta"], markersize=5, label="light")
        axis.plot([], [], "s", color=COLOURS["overfit"], markersize=4, label="detector")
        if len(before[0]):
            axis.plot([], [], "o", color=MUTED, markersize=5, label="measured before")
        figure.legend(loc="outside lower center", ncols=3)
    return Drawn(
        figure,
        f"{len(wi)} pairs of directions from above, light and detector joined; beside it what they leave open.",
    )


def _errors(figure: Figure, axes: list[Axes], maps: tuple[Tensor, Tensor]) -> None:
    """Two pictures with one scale, logarithmic."""
    high = float(maps[0].nan_to_num().max())
    scale = LogNorm(high / 3000, high)
    for axis, errors, when in zip(axes, maps, ("before", "after"), strict=True):
        image = axis.imshow(errors.T, origin="lower", extent=(0, 90, 0, 90), norm=scale, cmap="magma")
        axis.set_title(f"expected error x100 {when}")
        axis.set_ylabel("difference angle")
        axis.grid(visible=False)
        axis.set_xticks([0, 30, 60, 90])
        axis.set_yticks([0, 30, 60, 90])
    axes[1].set_xlabel("half angle, degrees")
    figure.colorbar(image, ax=axes, shrink=0.8)


def _pair(axis: Axes, light: Tensor, detector: Tensor, colour: str, number: str) -> None:
    places = [(math.atan2(float(y), float(x)), math.degrees(math.acos(min(1.0, float(z))))) for x, y, z in
              (light.tolist(), detector.tolist())]  # fmt: skip
    (a, r), (b, s) = places
    axis.plot([a, b], [r, s], color="#c8c8c8", linewidth=0.6, zorder=1)
    axis.plot([a], [r], "o", color=colour, markersize=5, zorder=3)
    axis.plot([b], [s], "s", color=MUTED if colour == MUTED else COLOURS["overfit"], markersize=4, zorder=2)
    if number:
        axis.annotate(number, (a, r), xytext=(4, 3), textcoords="offset points", fontsize=7, color=INK)
