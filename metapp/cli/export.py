"""`metapp export`: write the fits of a run in another file format."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from metapp.cli import completion
from metapp.cli.console import print_json
from metapp.cli.data_convert import check_folder
from metapp.cli.fit_options import exports
from metapp.cli.options import FittedData, Json, RunPath
from metapp.runs.reporter import say


def command(
    run: RunPath,
    form: Annotated[str, typer.Argument(metavar="KIND", autocompletion=completion.exports, help=f"{exports()}.")],
    inputs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[INPUT]...",
            help="Original input, for formats that need it: nbrdf of a ridge fit, surfaces of flash photos. The "
            "embedded data set is found automatically.",
        ),
    ] = None,
    data: FittedData = None,
    out_folder: Annotated[
        Path | None,
        typer.Option("--out", callback=check_folder, help="Folder to write to; default: RUN/KIND."),
    ] = None,
    size: Annotated[str, typer.Option(metavar="HxW", help="Output size in pixels, as for the paradigms.")] = "",
    json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False,
) -> None:
    """Write every fit of a run in another file format, as --export of the paradigms does.

    Example: metapp export RUN bsdf
    """
    from metapp.runs.outputs import export_run

    done = export_run(run, form, inputs or [], data=data, out=out_folder, size=size, quiet=quiet)
    if not quiet:
        say(f"{len(done.tasks)} fit{'s' * (len(done.tasks) != 1)} written as {done.form}: {done.out}")
    if json:
        print_json(done._asdict())
