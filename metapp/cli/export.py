"""`metapp export`: write the fits of a run in another file format."""

from __future__ import annotations

from dataclasses import field, make_dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from metapp.cli import completion
from metapp.cli.console import print_json
from metapp.cli.data.convert import check_folder
from metapp.cli.fits.options import exports
from metapp.cli.options import FittedData, Json, RunPath, annotated, plain, takes
from metapp.runs.reporter import say
from metapp.runs.requests.options import all_shown_options

_INPUTS = typer.Argument(
    metavar="[INPUT]...",
    help="Original input, for formats that need it: nbrdf of a ridge fit, surfaces of flash photos. The "
    "embedded data set is found automatically.",
)
_OUT = typer.Option("--out", callback=check_folder, help="Folder to write to; default: RUN/KIND.")
_OWN = all_shown_options()
_FIELDS: list[tuple[str, object] | tuple[str, object, object]] = [
    ("run", RunPath),
    ("form", Annotated[str, typer.Argument(metavar="KIND", autocompletion=completion.exports, help=f"{exports()}.")]),
    ("inputs", Annotated[list[Path] | None, _INPUTS], field(default=None)),
    ("data", FittedData, field(default=None)),
    ("out", Annotated[Path | None, _OUT], field(default=None)),
    *((name, annotated(option, given=True), field(default=None)) for name, option in _OWN.items()),
    ("json", Json, field(default=False)),
    ("quiet", Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")], field(default=False)),
]


@takes(make_dataclass("Options", _FIELDS))
def command(options: Any) -> None:
    """Write every fit of a run in another file format, as --export of the paradigms does.

    Example: metapp export RUN bsdf
    """
    from metapp.runs.outputs.files import export_run

    own = {name: plain(value) for name in _OWN if (value := getattr(options, name)) is not None}
    done = export_run(
        options.run,
        options.form,
        options.inputs or [],
        data=options.data,
        out=options.out,
        options=own,
        quiet=options.quiet,
    )
    if not options.quiet:
        say(f"{len(done.tasks)} fit{'s' * (len(done.tasks) != 1)} written as {done.form}: {done.out}")
    if options.json:
        print_json(done._asdict())
