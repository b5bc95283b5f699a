"""Figures of an evaluation's fits, and the report, which has them below its tables.

The module draws what tables and traces hold, and measures nothing itself.
"""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from metapp.evaluation.evaluation_run import EvaluationRun
from metapp.evaluation.style import FIGURE_STYLE, MUTED_COLOUR, PARADIGM_COLOURS, place_labels, save_figure
from metapp.evaluation.table import Table, format_tables
from metapp.evaluation.tables.convergence import CURVE_PARADIGMS, traced_fits
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

CaptionedFigure = tuple[Figure, str]  # a figure, and its content in words for readers who cannot see it


def _make_panel(evaluation: EvaluationRun, height: float, x_label: str) -> tuple[Figure, Axes]:
    """Make a figure of one panel whose vertical axis is the application's error."""
    figure = Figure(figsize=(4.0, height))
    axis = figure.subplots()
    axis.set_title(evaluation.title)
    axis.set_xlabel(x_label)
    axis.set_ylabel(f"error{evaluation.app.error_measure.factor}")
    return figure, axis


def draw_error_over_seconds(evaluation: EvaluationRun) -> CaptionedFigure | None:
    """Draw each paradigm's mean error with its 95 % interval over its median seconds; the best place is the top right.

    Crosses are baselines without a network.

    Returns:
        The figure and its caption; None if nothing was measured.
    """
    rows = {row["paradigm"]: row for row in evaluation.table("results").rows if row["paradigm"] in PARADIGM_COLOURS}
    rows = {name: row for name, row in rows.items() if None not in (row["error"], row["seconds"])}
    if not rows:
        return None
    figure, axis = _make_panel(evaluation, 3.0, "seconds of inference (faster to the right)")
    axis.set_ylabel(f"{axis.get_ylabel()} (better above)")
    for name, row in rows.items():
        interval = [[row["error"] - row["low"]], [row["high"] - row["error"]]]
        marker_size = 12 if name == "meta" else 7
        axis.errorbar(
            row["seconds"],
            row["error"],
            yerr=interval,
            capsize=2,
            fmt=PARADIGM_MARKERS[name],
            color=PARADIGM_COLOURS[name],
            markersize=marker_size,
        )
    baselines = [row for name in registry().tables for row in evaluation.table(name).rows if row.get("baseline")]
    baselines = [row for row in baselines if None not in (row["error"], row["seconds"])]
    for row in baselines:
        axis.plot(row["seconds"], row["error"], "x", color=MUTED_COLOUR, markersize=5)
    axis.set_xscale("log")
    axis.invert_xaxis()
    axis.invert_yaxis()
    axis.margins(x=0.28, y=0.12)
    labelled_rows = [
        *((PARADIGM_TITLES[name], row) for name, row in rows.items()),
        *((row["paradigm"], row) for row in baselines),
    ]
    text_styles = [{"fontsize": 8}] * len(rows) + [{"fontsize": 6, "color": MUTED_COLOUR}] * len(baselines)
    place_labels(
        axis,
        [
            (name, (row["seconds"], row["error"]), text_style)
            for (name, row), text_style in zip(labelled_rows, text_styles, strict=True)
        ],
    )
    figures = ", ".join(f"{name} {row['error']:.3f} in {row['seconds']:.3g} s" for name, row in labelled_rows)
    return figure, f"{evaluation.title}: mean error over seconds of inference. {figures}."


def draw_error_curves(evaluation: EvaluationRun) -> CaptionedFigure | None:
    """Draw the mean error over the traced tasks along the steps of each paradigm.

    The scale of errors is logarithmic if all are positive.

    Returns:
        The figure and its caption; None if nothing was traced, or if the tasks have no reference.
    """
    fits = traced_fits(evaluation)
    if not fits or fits[0].figures["curves"]["meta"][0][1] is None:
        return None
    figure, axis = _make_panel(evaluation, 3.2, "gradient steps")
    axis.set_xscale("symlog", linthresh=1)
    axis.xaxis.set_minor_locator(NullLocator())
    last_errors = []
    for name in CURVE_PARADIGMS:
        points_by_step = zip(*(fit.figures["curves"][name] for fit in fits), strict=True)
        mean_errors = {points[0][0]: statistics.fmean(error for _, error in points) for points in points_by_step}
        marker_size, steps, errors = 7 if name == "meta" else 4, list(mean_errors), list(mean_errors.values())
        axis.plot(
            steps,
            errors,
            color=PARADIGM_COLOURS[name],
            marker=PARADIGM_MARKERS[name],
            markersize=marker_size,
            label=PARADIGM_TITLES[name],
        )
        last_errors.append(f"{PARADIGM_TITLES[name]} {errors[-1]:.3f}")
    if axis.dataLim.y0 > 0:
        axis.set_yscale("log")
    figure.legend(loc="outside lower center", ncols=len(CURVE_PARADIGMS), columnspacing=1.0, handletextpad=0.4)
    tasks = f"mean over {len(fits)} tasks"
    return figure, f"{evaluation.title}: error along the steps, {tasks}. In the end: {', '.join(last_errors)}."


FIGURE_FUNCTIONS = {"plane": draw_error_over_seconds, "curves": draw_error_curves}


def draw_figure(name: str, evaluation: EvaluationRun) -> CaptionedFigure | None:
    """Draw the figure that FIGURE_FUNCTIONS has under a name; None if there is no fit for it yet."""
    with rc_context(FIGURE_STYLE):
        return FIGURE_FUNCTIONS[name](evaluation)


def write_figures(evaluations: Sequence[EvaluationRun], folder: Path) -> dict[Path, str]:
    """Write all figures of evaluations as <app>-<name>.png and .pdf.

    Args:
        evaluations: applications with their fits.
        folder: the folder to write to.

    Returns:
        The caption of each PNG file, by its path.
    """
    captions = {}
    for evaluation in evaluations:
        for name in FIGURE_FUNCTIONS:
            if captioned_figure := draw_figure(name, evaluation):
                figure, caption = captioned_figure
                stem = f"{evaluation.app.full_name} {name}".replace(" ", "-")
                save_figure(figure, folder / f"{stem}.pdf")
                captions[save_figure(figure, folder / f"{stem}.png")] = caption
    return captions


def write_report(evaluations: Sequence[EvaluationRun], folder: Path, tables: Mapping[str, Sequence[Table]]) -> Path:
    """Write the report `index.md`: tables, then figures, which are written beside it.

    Args:
        evaluations: applications with their fits.
        folder: the folder to write to.
        tables: the tables of all applications, by the table's name.

    Returns:
        The path of the report.
    """
    parts = ["# Tables and figures"]
    for name, app_tables in tables.items():
        filled_tables = [table for table in app_tables if table.rows]
        parts += [
            f"## {registry().tables[name].heading or name}",
            format_tables(filled_tables, "markdown") if filled_tables else "Not measured yet.",
        ]
    for file, caption in write_figures(evaluations, folder).items():
        parts += [f"## {file.stem}", f"![{caption}]({file.name})", caption]
    write_bytes(folder / "index.md", ("\n\n".join(parts) + "\n").encode())
    return folder / "index.md"
