"""`metapp export`: write the fits of a run in another file format."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from metapp.cli import completion
from metapp.cli.console import print_json
from metapp.cli.data.convert import check_folder
from metapp.cli.fits.options import exports
from metapp.cli.options import FittedData, Json, RunPath, extended
from metapp.runs.reporter import say
from metapp.runs.requests.options import all_shown_options


@extended(all_shown_options().values())
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
    out: Annotated[
        Path | None, typer.Option("--out", callback=check_folder, help="Folder to write to; default: RUN/KIND.")
    ] = None,
    json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False,
    **own: object,
) -> None:
    """Write every fit of a run in another file format, as --export of the paradigms does.

    Example: metapp export runs/brdf/meta bsdf
    """
    from metapp.runs.outputs.files import export_run, listed

    done = export_run(run, form, inputs or [], data=data, out=out, options=own, quiet=quiet)
    if not quiet:
        say(f"written as {done.form}: {listed(Path(done.out), done.tasks)}")
    if json:
        print_json(done._asdict())
