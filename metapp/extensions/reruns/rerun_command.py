"""`metapp rerun`: repeat rows of tables from their records."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metapp.cli.console import Exit, out, print_json
from metapp.cli.options import FittedData, Json
from metapp.cli.streams import escaped
from metapp.runs.reporter import number, say
from metapp.storage import Document

if TYPE_CHECKING:
    from rich.table import Table

    from metapp.extensions.reruns.rerun import Repeated


def command(
    record: Annotated[Path, typer.Argument(metavar="RECORD", help="Folder of a run, or of runs: the newest in it.")],
    inputs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[INPUT]...", help="Original input, if it has moved."),
    ] = None,
    task: Annotated[str, typer.Option(metavar="NAME", help="Repeat this task alone; default: all.")] = "",
    data: FittedData = None,
    checkpoint: Annotated[Path | None, typer.Option(help="Checkpoint of the run; default: the recorded one.")] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            min=0,
            help="Maximum relative difference of figures that agree; default: 1e-6 on the same machine by the same "
            "versions and threads, 0.01 elsewhere.",
        ),
    ] = None,
    json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar, no table.")] = False,
) -> int:
    """Repeat the fits of a run from its records and check that errors agree; if not, the exit code is 1.

    Example: metapp rerun RUN
    """
    from metapp.extensions.reruns.rerun import Instead, rerun

    rows = rerun(record, task, Instead(inputs or [], data, checkpoint, tolerance), quiet=quiet)
    failed = [row.name for row in rows if not row.agrees]
    if not (quiet or json):
        out().print(_table(rows))
    if not quiet:
        _say_conditions(rows)
        if failed:
            say(f"{len(failed)} of {len(rows)} figures do not agree: {', '.join(failed)}")
        else:
            say(f"{'the figure agrees' if len(rows) == 1 else f'all {len(rows)} figures agree'} with the record")
    if json:
        print_json({"agrees": not failed, "tasks": [_document(row) for row in rows]})
    return Exit.FAILED if failed else Exit.DONE


def _document(row: Repeated) -> Document:
    difference = row.difference if row.difference < float("inf") else None
    return row._asdict() | {"difference": difference, "agrees": row.agrees}


def _say_conditions(rows: list[Repeated]) -> None:
    """Name each version, device or machine that is not as it was, once."""
    differs = {f"{name}: {then} then, {now} now" for row in rows for name, (then, now) in row.differs.items()}
    for each in sorted(differs):
        say(f"note: {each}")


def _table(rows: list[Repeated]) -> Table:
    """One line a task: errors, their difference and how much of it is rounding, seconds."""
    from rich.table import Table

    table = Table(caption="difference: relative, of errors; of parameters where there is no reference")
    table.add_column("task")
    for title in ("recorded", "found", "difference", "up to", "agrees", "seconds then", "now"):
        table.add_column(title, justify="right")
    for row in rows:
        errors = [number(each, ".6g") for each in (row.recorded, row.found)]
        seconds = [number(each, ".4f") for each in row.seconds or (None, None)]
        agrees = "yes" if row.agrees else "no"
        table.add_row(escaped(row.name), *errors, f"{row.difference:.1e}", f"{row.tolerance:g}", agrees, *seconds)
    return table
