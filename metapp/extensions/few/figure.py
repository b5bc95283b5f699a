"""Directions to measure, seen from above: where the light is, where the detector, in which order."""

from __future__ import annotations

import math

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes
from torch import Tensor

from data_tools.readers.measured_pairs import Pairs
from metapp.evaluation.style import COLOURS, INK, MUTED, STYLE

NUMBERED = 32  # pairs up to which each has its number


def directions(wi: Tensor, wo: Tensor, before: Pairs) -> Figure:
    """Pairs of directions to measure, unit vectors [N, 3] to light and detector, and those measured before."""
    with rc_context(STYLE):
        figure = Figure(figsize=(5.2, 5.6), layout="constrained")
        axis = figure.add_subplot(projection="polar")
        assert isinstance(axis, PolarAxes)
        axis.set_rlim(0, 90)
        axis.set_rticks([30, 60, 90], ["30", "60", "90 degrees"])
        axis.set_thetagrids(range(0, 360, 45))
        for light, detector in zip(before.wi, before.wo, strict=True):
            _pair(axis, light, detector, MUTED, "")
        for at, (light, detector) in enumerate(zip(wi, wo, strict=True), 1):
            _pair(axis, light, detector, COLOURS["meta"], str(at) if len(wi) <= NUMBERED else "")
        axis.plot([], [], "o", color=COLOURS["meta"], markersize=5, label="light")
        axis.plot([], [], "s", color=COLOURS["overfit"], markersize=4, label="detector")
        if len(before.wi):
            axis.plot([], [], "o", color=MUTED, markersize=5, label="measured before")
        figure.legend(loc="outside lower center", ncols=3)
    return figure


def _pair(axis: Axes, light: Tensor, detector: Tensor, colour: str, number: str) -> None:
    places = [(math.atan2(float(y), float(x)), math.degrees(math.acos(min(1.0, float(z))))) for x, y, z in
              (light.tolist(), detector.tolist())]  # fmt: skip
    (a, r), (b, s) = places
    axis.plot([a, b], [r, s], color="#c8c8c8", linewidth=0.6, zorder=1)
    axis.plot([a], [r], "o", color=colour, markersize=5, zorder=3)
    axis.plot([b], [s], "s", color=MUTED if colour == MUTED else COLOURS["overfit"], markersize=4, zorder=2)
    if number:
        axis.annotate(number, (a, r), xytext=(4, 3), textcoords="offset points", fontsize=7, color=INK)
