"""Figures of a subject's records, and the report, which has them below its tables."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from metapp.apps import full_name
from metapp.evaluation.style import FIGURE_STYLE, MUTED_COLOUR, PARADIGM_COLOURS, place_labels, save_figure
from metapp.evaluation.subject import EvaluationRun
from metapp.evaluation.table import Table, format_tables
from metapp.evaluation.tables.convergence import CURVE_PARADIGMS, trace_records
from metapp.registry import registry
from metapp.storage.files import write_bytes

PARADIGM_MARKERS = {"general": "o", "overfit": "s", "finetune": "D", "quickft": "^", "meta": "*"}
PARADIGM_TITLES = {
    "general": "General",
    "overfit": "Overfit",
    "finetune": "Finetune",
    "quickft": "QuickFT",
    "meta": "Meta",
}

CaptionedFigure = tuple[Figure, str]  # a figure, and its description in words for those who read it or hear it


def _panel(subject: EvaluationRun, height: float, x_label: str) -> tuple[Figure, Axes]:
    """A figure of one panel, errors upward."""
    figure = Figure(figsize=(4.0, height))
    axis = figure.subplots()
    axis.set_title(subject.title)
    axis.set_xlabel(x_label)
    axis.set_ylabel(f"error{subject.app.error_measure.factor}")
    return figure, axis


def draw_error_over_seconds(subject: EvaluationRun) -> CaptionedFigure | None:
    """Mean error with its 95 % interval over median seconds; crosses are other methods, best is top right."""
    rows = {row["paradigm"]: row for row in subject.table("results").rows if row["paradigm"] in PARADIGM_COLOURS}
    rows = {name: row for name, row in rows.items() if None not in (row["error"], row["seconds"])}
    if not rows:
        return None
    figure, axis = _panel(subject, 3.0, "seconds of inference (faster to the right)")
    axis.set_ylabel(f"{axis.get_ylabel()} (better above)")
    for name, row in rows.items():
        reach = [[row["error"] - row["low"]], [row["high"] - row["error"]]]
        size, place = 12 if name == "meta" else 7, (row["seconds"], row["error"])
        axis.errorbar(
            *place, yerr=reach, capsize=2, fmt=PARADIGM_MARKERS[name], color=PARADIGM_COLOURS[name], markersize=size
        )
    baselines = [row for name in registry().tables for row in subject.table(name).rows if row.get("baseline")]
    others = [row for row in baselines if None not in (row["error"], row["seconds"])]
    for row in others:
        axis.plot(row["seconds"], row["error"], "x", color=MUTED_COLOUR, markersize=5)
    axis.set_xscale("log")
    axis.invert_xaxis()
    axis.invert_yaxis()
    axis.margins(x=0.28, y=0.12)
    named = [*((PARADIGM_TITLES[name], row) for name, row in rows.items()), *((row["paradigm"], row) for row in others)]
    looks = [{"fontsize": 8}] * len(rows) + [{"fontsize": 6, "color": MUTED_COLOUR}] * len(others)
    place_labels(
        axis, [(name, (row["seconds"], row["error"]), look) for (name, row), look in zip(named, looks, strict=True)]
    )
    figures = ", ".join(f"{name} {row['error']:.3f} in {row['seconds']:.3g} s" for name, row in named)
    return figure, f"{subject.title}: mean error over seconds of inference. {figures}."


def draw_error_curves(subject: EvaluationRun) -> CaptionedFigure | None:
    """Mean error over the traced tasks along the steps of each paradigm, on a logarithmic scale if all are positive."""
    records = trace_records(subject)
    if not records or records[0]["curves"]["meta"][0][1] is None:
        return None
    figure, axis = _panel(subject, 3.2, "gradient steps")
    axis.set_xscale("symlog", linthresh=1)
    axis.xaxis.set_minor_locator(NullLocator())
    ends = []
    for name in CURVE_PARADIGMS:
        along = zip(*(record["curves"][name] for record in records), strict=True)
        line = {pairs[0][0]: statistics.fmean(error for _, error in pairs) for pairs in along}
        size, x, y = 7 if name == "meta" else 4, list(line), list(line.values())
        axis.plot(
            x,
            y,
            color=PARADIGM_COLOURS[name],
            marker=PARADIGM_MARKERS[name],
            markersize=size,
            label=PARADIGM_TITLES[name],
        )
        ends.append(f"{PARADIGM_TITLES[name]} {y[-1]:.3f}")
    if axis.dataLim.y0 > 0:
        axis.set_yscale("log")
    figure.legend(loc="outside lower center", ncols=len(CURVE_PARADIGMS), columnspacing=1.0, handletextpad=0.4)
    tasks = f"mean over {len(records)} tasks"
    return figure, f"{subject.title}: error along the steps, {tasks}. In the end: {', '.join(ends)}."


FIGURE_FUNCTIONS = {"plane": draw_error_over_seconds, "curves": draw_error_curves}


def draw_figure(name: str, subject: EvaluationRun) -> CaptionedFigure | None:
    """The figure of that name, with its caption; None if there is no record for it yet."""
    with rc_context(FIGURE_STYLE):
        return FIGURE_FUNCTIONS[name](subject)


def write_figures(subjects: Sequence[EvaluationRun], folder: Path) -> dict[Path, str]:
    """Write the figures as <app>-<name>.png and .pdf.

    Returns:
        The caption of each PNG file.
    """
    captions = {}
    for subject in subjects:
        for name in FIGURE_FUNCTIONS:
            if drawn := draw_figure(name, subject):
                figure, caption = drawn
                stem = f"{full_name(subject.app)} {name}".replace(" ", "-")
                save_figure(figure, folder / f"{stem}.pdf")
                captions[save_figure(figure, folder / f"{stem}.png")] = caption
    return captions


def write_report(subjects: Sequence[EvaluationRun], folder: Path, tables: Mapping[str, Sequence[Table]]) -> Path:
    """Write `index.md`: tables of the subjects, by the table's name, then the figures, which lie beside it."""
    parts = ["# Tables and figures"]
    for name, of_subjects in tables.items():
        filled = [table for table in of_subjects if table.rows]
        parts += [
            f"## {registry().tables[name].help or name}",
            format_tables(filled, "markdown") if filled else "Not measured yet.",
        ]
    for file, caption in write_figures(subjects, folder).items():
        parts += [f"## {file.stem}", f"![{caption}]({file.name})", caption]
    write_bytes(folder / "index.md", ("\n\n".join(parts) + "\n").encode())
    return folder / "index.md"
