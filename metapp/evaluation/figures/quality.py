"""The quality-speed plane, and the errors of all test tasks, sorted for each paradigm."""

from __future__ import annotations

from matplotlib.ticker import MaxNLocator

from metapp.evaluation.figures import Drawn
from metapp.evaluation.figures.style import BASELINE, COLOURS, MARKERS, MUTED, TITLES, legend, line, new
from metapp.evaluation.rows import values_of
from metapp.evaluation.subject import Subject
from metapp.evaluation.tables.baselines import baseline_rows
from metapp.evaluation.tables.results import result_row
from metapp.runs.naming import factor_of

OFFSETS = {"meta": (8, 8), "quickft": (6, -13)}  # points; the two often lie close


def plane(subject: Subject) -> Drawn | None:
    """Mean error with its 95 % interval over median seconds, crosses are baselines; best is top right."""
    rows = {name: result_row(subject, name) for name in COLOURS}
    rows = {name: row for name, row in rows.items() if None not in (row["error"], row["seconds"])}
    if not rows:
        return None
    figure, axes = new(4.0, 3.0)
    axis = axes[0, 0]
    for name, row in rows.items():
        reach = [[row["error"] - row["low"]], [row["high"] - row["error"]]]
        look = {"fmt": MARKERS[name], "color": COLOURS[name], "markersize": 12 if name == "meta" else 7}
        axis.errorbar(row["seconds"], row["error"], yerr=reach, capsize=2, **look)
        where, away = (row["seconds"], row["error"]), OFFSETS.get(name, (6, 6))
        axis.annotate(TITLES[name], where, away, textcoords="offset points", fontsize=8)
    others = [row for row in baseline_rows(subject) if None not in (row["error"], row["seconds"])]
    for row in others:
        axis.plot(row["seconds"], row["error"], BASELINE, color=MUTED, markersize=5)
        look = {"fontsize": 6, "color": MUTED, "rotation": 40, "rotation_mode": "anchor"}  # names of neighbours part
        axis.annotate(row["paradigm"], (row["seconds"], row["error"]), (2, 3), textcoords="offset points", **look)
    axis.set_xscale("log")
    axis.invert_xaxis()
    axis.invert_yaxis()
    axis.margins(x=0.18, y=0.12)
    axis.set_xlabel("seconds of inference (faster to the right)")
    axis.set_ylabel(f"error{factor_of(subject.app)} (better above)")
    axis.set_title(subject.title)
    named = [*((TITLES[name], row) for name, row in rows.items()), *((row["paradigm"], row) for row in others)]
    figures = ", ".join(f"{name} {row['error']:.3f} in {row['seconds']:.3g} s" for name, row in named)
    return Drawn(figure, f"{subject.title}: mean error over seconds of inference. {figures}.")


def ranks(subject: Subject) -> Drawn | None:
    """Errors of the test tasks, each paradigm's sorted by itself."""
    by_name = {name: sorted(values_of(subject.cell(name)).values()) for name in COLOURS}
    by_name = {name: errors for name, errors in by_name.items() if errors}
    if not by_name:
        return None
    figure, axes = new(4.0, 3.2)
    axis = axes[0, 0]
    for name, errors in by_name.items():
        axis.plot(range(1, len(errors) + 1), errors, **line(name))
    if min(min(errors) for errors in by_name.values()) > 0:
        axis.set_yscale("log")
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    axis.set_xlabel("test task, each paradigm's in order of error")
    axis.set_ylabel(f"error{factor_of(subject.app)}")
    axis.set_title(subject.title)
    legend(figure)
    worst = ", ".join(f"{TITLES[name]} {errors[-1]:.3f}" for name, errors in by_name.items())
    return Drawn(figure, f"{subject.title}: errors of all test tasks, sorted. Worst: {worst}.")
