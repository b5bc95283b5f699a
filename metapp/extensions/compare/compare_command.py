"""The command `metapp compare`, which shows runs side by side.

Only arguments and help are made here; `side_by_side`, which imports torch, does the work.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.arguments import FittedData, JsonFlag, Overwrite, Quiet, RunPath, check_new_file
from metapp.cli.console import print_json, standard_output
from metapp.runs.reporter import say


def compare_command(
    first: RunPath,
    second: Annotated[Path, typer.Argument(metavar="RUN", help="Another run of the same application.")],
    others: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[RUN|INPUT]...",
            help="Further runs; or the files that were fitted, if they have moved, for the picture.",
        ),
    ] = None,
    task: Annotated[
        str, typer.Option(metavar="NAME", help="Compare this task alone; default: all tasks in common.")
    ] = "",
    data: FittedData = None,
    out_file: Annotated[
        Path | None,
        typer.Option("--out", dir_okay=False, help="Picture to write; default: comparison.png in the first RUN."),
    ] = None,
    overwrite: Overwrite = False,
    json: JsonFlag = False,
    quiet: Quiet = False,
) -> None:
    """Compare runs with the first of them: errors of each task, ratio of mean errors with its interval, picture.

    Example: metapp compare runs/brdf/meta runs/brdf/quickft
    """
    from metapp.extensions.compare.side_by_side import compare_runs, comparison_table

    check_new_file(out_file, overwrite)
    comparison, picture = compare_runs([first, second], others or [], task, data, out_file, quiet=quiet)
    if not (quiet or json):
        standard_output().print(comparison_table(comparison))
    if not quiet:
        for note in comparison.notes:
            say(f"note: {note}")
        no_picture = "no picture: fits or the fitted files are missing; name the fitted files after the runs."
        say(f"picture: {picture}" if picture else no_picture)
    if json:
        print_json(comparison.document(picture))
