"""Errors of fits along the steps, and their paths through the space of parameters."""

from __future__ import annotations

import statistics

from matplotlib.ticker import NullLocator

from metapp.evaluation.figures import Drawn
from metapp.evaluation.figures.style import COLOURS, INK, TITLES, legend, line, new
from metapp.evaluation.subject import Subject
from metapp.evaluation.trace import CURVES, trace_cell
from metapp.runs.naming import factor_of

SHOWN = 3  # paths


def curves(subject: Subject) -> Drawn | None:
    """Mean error over the traced tasks along the steps of each paradigm."""
    records = trace_cell(subject).records()
    if not records or records[0]["curves"]["meta"][0][1] is None:
        return None
    figure, axes = new(4.0, 3.2)
    axis = axes[0, 0]
    last = {}
    for name in CURVES:
        steps = [step for step, _ in records[0]["curves"][name]]
        errors = [statistics.fmean(r["curves"][name][i][1] for r in records) for i in range(len(steps))]
        axis.plot(steps, errors, **line(name))
        last[name] = errors[-1]
    axis.set_xscale("symlog", linthresh=1)
    if min(value for record in records for name in CURVES for _, value in record["curves"][name]) > 0:
        axis.set_yscale("log")
    axis.xaxis.set_minor_locator(NullLocator())
    axis.set_xlabel("gradient steps")
    axis.set_ylabel(f"error{factor_of(subject.app)}")
    axis.set_title(subject.title)
    legend(figure)
    errors_said = ", ".join(f"{TITLES[name]} {error:.3f}" for name, error in last.items())
    caption = f"{subject.title}: error along the steps, mean over {len(records)} tasks. In the end: {errors_said}."
    return Drawn(figure, caption)


def trajectories(subject: Subject) -> Drawn | None:
    """Meta's and Overfit's paths in the plane of most variance of their parameters, a few tasks.

    None where their networks differ, as they do where a rule solves for the last layer.
    """
    records = [record for record in trace_cell(subject).records() if record["paths"]["meta"]][:SHOWN]
    if not records:
        return None
    figure, axes = new(2.6 * len(records) + 0.4, 2.9, 1, len(records))
    for axis, record in zip(axes[0], records, strict=True):
        for name in ("overfit", "meta"):
            x, y = zip(*record["paths"][name], strict=True)
            axis.plot(x, y, color=COLOURS[name], marker=".", markersize=3, linewidth=1.2, label=TITLES[name])
            axis.plot(x[0], y[0], "o", color="white", markeredgecolor=COLOURS[name], markersize=7)
            axis.plot(x[-1], y[-1], "*", color=COLOURS[name], markeredgecolor=INK, markeredgewidth=0.5, markersize=11)
        axis.set_xticklabels([])
        axis.set_yticklabels([])
        name = record["name"] if len(record["name"]) < 26 else record["name"][:24] + "…"
        axis.set_title(f"{name}\n{record['explained']:.0%} of the variance", fontsize=8, parse_math=False)
    legend(figure)
    figure.suptitle(f"{subject.title}: from the initialisation (ring) to the result (star)", fontsize=10)
    tasks = ", ".join(record["name"] for record in records)
    return Drawn(
        figure, f"{subject.title}: paths of Meta and Overfit through parameter space, in two principal axes: {tasks}."
    )
