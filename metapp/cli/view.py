"""`metapp view`: an interactive page of runs."""

from __future__ import annotations

import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.console import print_json
from metapp.cli.options import FittedData, Json, OpenPage, takes
from metapp.runs.reporter import say


@dataclass(frozen=True)
class Options:
    """Of the command."""

    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN...", help="Run folders or files of their params/; several are shown side by side."),
    ]
    inputs: Annotated[
        list[Path] | None,
        typer.Option("--input", metavar="INPUT", help="Original input, if it has moved."),
    ] = None
    task: Annotated[str, typer.Option(metavar="NAME", help="Show this task alone; default: all.")] = ""
    most: Annotated[int, typer.Option(min=1, help="Maximum number of tasks.")] = 20
    data: FittedData = None
    out: Annotated[
        Path | None, typer.Option(dir_okay=False, help="Output file; default: view.html in the first RUN.")
    ] = None
    open_page: OpenPage = True
    json: Json = False
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False


@takes(Options)
def command(options: Options) -> None:
    """Write an interactive HTML page of fits; several runs of the same tasks are shown side by side.

    RUN is the folder that a fit prints.

    Example: metapp view RUN OTHER_RUN
    """
    from metapp.runs.viewing import Wanted, view_page

    wanted = Wanted(options.runs, options.inputs or [], options.data, options.task, options.most)
    page = view_page(wanted, options.out, quiet=options.quiet)
    if options.open_page:
        webbrowser.open(page.resolve().as_uri())
    if options.json:
        print_json({"page": str(page), "bytes": page.stat().st_size})
    else:
        say(f"page: {page}, {page.stat().st_size / 1e6:.1f} MB")
