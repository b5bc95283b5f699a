"""Runs that a command line names, side by side: their comparison, its picture and its table.

It tells runs from inputs among the paths of the command, and lays out what `comparison` found.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from metapp.cli.console import escape_control_characters
from metapp.evaluation.error_statistics import MIN_TASK_GROUPS
from metapp.extensions.compare.comparison import Comparison, draw_comparison, read_comparison
from metapp.runs.reporter import format_number, progress
from metapp.runs.stored_fits import holds_fits


def compare_runs(
    runs: Sequence[Path], others: Sequence[Path], task: str, data: Path | None, picture: Path | None, *, quiet: bool
) -> tuple[Comparison, Path | None]:
    """Compare runs with the first of them, and draw the fits of all.

    Args:
        runs: the folders of two or more runs.
        others: further runs, and inputs that were fitted, if these have moved.
        task: the name of the task to compare; "" for all tasks in common.
        data: the data set that was fitted, if it has moved.
        picture: the file to write; None for comparison.png in the folder of the first run.
        quiet: whether no progress is shown.

    Returns:
        The comparison, and the picture that was written; None if what was fitted cannot be read.

    Raises:
        ValueError: there are no runs, they are of different applications, or have no task in common.
    """
    further_runs = [path for path in others if holds_fits(path)]
    inputs = [path for path in others if path not in further_runs]
    with progress("compare: reading what was fitted", quiet=quiet):
        comparison = read_comparison([*runs, *further_runs], task, inputs, data)
    written, comparison = draw_comparison(
        comparison, picture or comparison.runs[0].folder / "comparison.png", quiet=quiet
    )
    return comparison, written


def comparison_table(comparison: Comparison) -> Table:
    """Return a table with a column for each run: errors of tasks, their means, how these compare, and seconds."""
    runs, presenter = comparison.runs, comparison.runs[0].presenter
    pairs = [measure.comparison for measure in comparison.errors]
    base, known_pairs = runs[0].label, [pair for pair in pairs if pair]
    captions = [presenter.caption()]
    if known_pairs and known_pairs[0].groups < MIN_TASK_GROUPS:
        captions.append(f"{known_pairs[0].groups} different tasks are too few to call a win")
    for title, run_means in comparison.measures.items():
        run_texts = (
            f"{run.label} {format_number(measure.mean, '.3f')}"
            + (f" (ratio {measure.comparison})" if measure.comparison else "")
            for run, measure in zip(runs, run_means, strict=True)
        )
        captions.append(f"{title}: {', '.join(run_texts)}")
    table = Table(
        title=f"{presenter.title}, error{presenter.app.error_measure.factor}",
        caption="\n".join(captions),
        caption_justify="left",
    )
    table.add_column("task")
    for run in runs:
        table.add_column(run.label, justify="right")
    for task_fits in zip(*(run.fits for run in runs), strict=True):
        table.add_row(
            escape_control_characters(task_fits[0].name),
            *(format_number(fit.error, ".3f") for fit in task_fits),
        )
    table.add_section()
    table.add_row("mean error", *(format_number(measure.mean, ".3f") for measure in comparison.errors))
    if known_pairs:
        number_format = ".3f" if known_pairs[0].kind == "ratio" else "+.3f"
        rows = {
            {"ratio": "ratio to", "difference": "difference from"}[known_pairs[0].kind] + f" {base}'s": "{0.value:%s}",
            "95 % interval": "{0.low:%s} .. {0.high:%s}",
            f"lower than {base}'s on": "{0.ahead}/{0.tasks}",
        }
        for title, row_format in rows.items():
            table.add_row(
                title, *(row_format.replace("%s", number_format).format(pair) if pair else "-" for pair in pairs)
            )
    table.add_row("median seconds", *(format_number(run.median_seconds(), ".4f") for run in runs))
    return table
