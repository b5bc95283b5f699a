"""`metapp baseline`: run a method of the baselines table on files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from metapp import door
from metapp.cli import completion
from metapp.cli.console import out, print_json
from metapp.cli.options import Json, Seed, extended, takes
from metapp.runs.reporter import say
from metapp.runs.requests.options import all_shown_options, options_of


@dataclass(frozen=True)
class Options:
    """The options of the command."""

    app: Annotated[
        str,
        typer.Argument(metavar="APP", autocompletion=completion.applications, help="An application, such as texture."),
    ]
    inputs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[INPUT]...", help="Files of APP or folders; default: the test tasks of --data."),
    ] = None
    method: Annotated[
        str,
        typer.Option(
            autocompletion=completion.methods,
            help="Such as quilting or gpdm of texture; an unknown name lists the methods of APP.",
        ),
    ] = "nearest"
    recipe: Annotated[
        str, typer.Option(autocompletion=completion.recipes, help="quick, full or paper; sets the image resolution.")
    ] = ""
    observe: Annotated[
        str,
        typer.Option(
            autocompletion=completion.observations,
            help="What methods see: reference (ground truth, the default) or photo (photos alone).",
        ),
    ] = ""
    data: Annotated[Path | None, typer.Option(help="Data set whose training tasks a method may learn from.")] = None
    out: Annotated[Path, typer.Option(help="Folder for runs.")] = Path("runs")
    seed: Seed = 0
    json: Json = False
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar, no table.")] = False


def all_read_options() -> dict[str, door.Option]:
    """The options that say how inputs are read, of formats, of merges and of recipes, by name."""
    of_presentations, others = all_shown_options(), (door.Output, door.Watcher)
    names = {
        option.name: option
        for application in door.offers(door.Application)
        for option, owner in options_of(application.name)
        if not isinstance(owner, others)
    }
    return {name: option for name, option in names.items() if name not in of_presentations}


@extended(all_read_options().values())  # as for fits: how inputs are read, and at which resolution
@takes(Options)
def baseline(options: Options, **own: object) -> None:
    """Run a baseline without a neural network and evaluate it in the same way as fits.

    Example: metapp baseline texture wall.jpg --method quilting
    """
    from metapp.cli.fits.run import table_of
    from metapp.extensions.baselines.run import run_baseline
    from metapp.runs.requests.plan import plan
    from metapp.runs.requests.request import Request

    request = Request(
        options.app,
        "general",
        options.inputs or [],
        recipe=options.recipe,
        observe=options.observe,
        options=own,
        data=options.data,
        out=options.out,
        seed=options.seed,
        device="cpu",
        quiet=options.quiet,
    )
    planned = plan(request)
    done = run_baseline(planned, options.method)
    if not (options.quiet or options.json):
        out().print(table_of(planned.app, options.method, done.records, done.made))
    if not options.quiet:
        say(f"{options.method} cannot {done.cannot}\nrecords: {done.folder}")
    if options.json:
        print_json(done.document())
