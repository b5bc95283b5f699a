"""Runs that a command line names, side by side: their comparison, its picture and its table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from metapp.cli.console import escape_control_characters
from metapp.evaluation.error_statistics import MIN_TASK_GROUPS
from metapp.extensions.compare.comparison import Comparison, draw_comparison, read_comparison
from metapp.runs.outputs.run_records import holds_fits
from metapp.runs.reporter import format_number, progress


def compare_runs(
    runs: Sequence[Path], others: Sequence[Path], task: str, data: Path | None, picture: Path | None, *, quiet: bool
) -> tuple[Comparison, Path | None]:
    """Compare runs with the first of them, and draw the fits of all.

    Args:
        runs: folders of runs, two or more.
        others: further runs, and inputs that were fitted, if these have moved.
        task: the name of the one to compare; "" for all in common.
        data: the data set that was fitted, if it has moved.
        picture: the file to write; None for comparison.png in the folder of the first run.
        quiet: no progress.

    Returns:
        The comparison, and the picture that was written; None if what was fitted cannot be read.

    Raises:
        ValueError: no runs, of different applications, or without a task in common.
    """
    further = [path for path in others if holds_fits(path)]
    inputs = [path for path in others if path not in further]
    with progress("compare: reading what was fitted", quiet=quiet):
        compared = read_comparison([*runs, *further], task, inputs, data)
    written, compared = draw_comparison(compared, picture or compared.sides[0].folder / "comparison.png", quiet=quiet)
    return compared, written


def comparison_table(compared: Comparison) -> Table:
    """Return a table with a column for each run: errors of tasks, their means, how these compare, and seconds."""
    sides, presenter = compared.sides, compared.sides[0].presenter
    pairs = [each.compared for each in compared.errors]
    base, known = sides[0].label, [pair for pair in pairs if pair]
    said = [presenter.caption()]
    if known and known[0].groups < MIN_TASK_GROUPS:
        said.append(f"{known[0].groups} different tasks are too few to call a win")
    for title, measured in compared.measures.items():
        of_sides = (
            f"{side.label} {format_number(each.mean, '.3f')}" + (f" (ratio {each.compared})" if each.compared else "")
            for side, each in zip(sides, measured, strict=True)
        )
        said.append(f"{title}: {', '.join(of_sides)}")
    table = Table(
        title=f"{presenter.title}, error{presenter.app.error_measure.factor}",
        caption="\n".join(said),
        caption_justify="left",
    )
    table.add_column("task")
    for side in sides:
        table.add_column(side.label, justify="right")
    for of_task in zip(*(side.records for side in sides), strict=True):
        table.add_row(
            escape_control_characters(of_task[0]["name"]), *(format_number(each["error"], ".3f") for each in of_task)
        )
    table.add_section()
    table.add_row("mean error", *(format_number(each.mean, ".3f") for each in compared.errors))
    if known:
        form = ".3f" if known[0].kind == "ratio" else "+.3f"
        rows = {
            {"ratio": "ratio to", "difference": "difference from"}[known[0].kind] + f" {base}'s": "{0.value:%s}",
            "95 % interval": "{0.low:%s} .. {0.high:%s}",
            f"lower than {base}'s on": "{0.ahead}/{0.tasks}",
        }
        for title, text in rows.items():
            table.add_row(title, *(text.replace("%s", form).format(pair) if pair else "-" for pair in pairs))
    table.add_row("median seconds", *(format_number(side.seconds(), ".4f") for side in sides))
    return table
