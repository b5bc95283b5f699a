"""The figure of the rule study: each rule's error over a tuned Adam's, at each number of steps."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

from benchmarks.rule_study import QUICKFT
from benchmarks.rule_table import rows, study_of
from metapp.evaluation.rows import Row, paired_of
from metapp.evaluation.style import COLOURS, GRID, INK, Drawn, new
from metapp.evaluation.subject import Subject

BELOW, ABOVE, LEVEL = COLOURS["overfit"], COLOURS["meta"], "#999999"
ROW = 0.21  # inches of a rule


def rules(subject: Subject) -> Drawn | None:
    """Error over QuickFT's with its 95 % interval; blue where it is below, orange above, grey where chance could be."""
    compared = [row for row in rows(subject) if paired_of(row, QUICKFT)]
    if not compared:
        return None
    study = study_of(subject)
    steps = sorted({row["steps"] for row in compared})
    names = [name for name in study.rules if any(row["rule"] == name for row in compared)]
    figure, axes = new(2.3 * len(steps) + 1.7, ROW * len(names) + 1.1, 1, len(steps))
    kind = "difference" if subject.presentation.logarithmic else "ratio"
    for axis, count in zip(axes[0], steps, strict=True):
        here = {row["rule"]: row for row in compared if row["steps"] == count}
        axis.axvline(0 if kind == "difference" else 1, color=INK, linewidth=1)
        for i, name in enumerate(names):
            if name in here:
                _mark(axis, -i, here[name])
        if kind == "ratio":
            _ratios(axis)
        axis.set_yticks([-i for i in range(len(names))], names if axis is axes[0, 0] else [], fontsize=7)
        axis.set_ylim(-len(names) + 0.4, 0.6)
        axis.set_title(f"{count} steps")
        axis.grid(axis="y", color=GRID, linewidth=0.4)
    outer = study.design.train_steps
    figure.suptitle(f"{subject.title}: learned rules after {outer:,} outer steps", fontsize=10)
    figure.supxlabel(f"error over tuned Adam's ({kind}, 95 % interval)", fontsize=8)
    return Drawn(
        figure, f"{subject.title}: mean error over that of a tuned Adam after as many steps. {_in_words(compared)}"
    )


def _mark(axis: Axes, height: float, row: Row) -> None:
    pair = paired_of(row, QUICKFT)
    assert pair is not None
    colour = LEVEL if not row["apart"] else BELOW if pair.value < pair.level else ABOVE
    axis.plot([pair.low, pair.high], [height, height], color=colour, linewidth=1.4, solid_capstyle="butt")
    axis.plot(pair.value, height, "o", color=colour, markersize=4)


def _ratios(axis: Axes) -> None:
    """A logarithmic axis with plain numbers."""
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(FixedLocator([0.25, 0.5, 0.7, 1, 1.5, 2, 3, 5, 10, 20]))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.tick_params(axis="x", labelsize=7)


def _in_words(compared: list[Row]) -> str:
    best: dict[int, Row] = {}
    for row in compared:
        if row["steps"] not in best or row["error"] < best[row["steps"]]["error"]:
            best[row["steps"]] = row
    return " ".join(f"{steps} steps: lowest {row['rule']}, {row['error']:.3f}." for steps, row in best.items())
