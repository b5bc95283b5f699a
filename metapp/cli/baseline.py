"""`metapp baseline`: run a method of the baselines table on files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.console import out, print_json
from metapp.cli.options import Json
from metapp.runs.reporter import say


def command(
    app: Annotated[str, typer.Argument(metavar="APP", help="An application, such as texture.")],
    inputs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[INPUT]...", help="Files of APP or folders; default: the test tasks of --data."),
    ] = None,
    method: Annotated[
        str, typer.Option(help="Such as quilting or gpdm of texture; another name lists those of APP.")
    ] = "nearest",
    recipe: Annotated[str, typer.Option(help="The size of pictures: quick, full or paper.")] = "",
    observe: Annotated[str, typer.Option(help="What a fit may see: reference (the default) or photo.")] = "",
    data: Annotated[Path | None, typer.Option(help="Data set whose training tasks a method may learn from.")] = None,
    out_folder: Annotated[Path, typer.Option("--out", help="Where runs are kept.")] = Path("runs"),
    seed: Annotated[int, typer.Option(min=0, help="Of all random draws.")] = 0,
    json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar, no table.")] = False,
) -> None:
    """Run a method that a reader would use instead of a network, and judge it as fits are.

    Example: metapp baseline texture wall.jpg --method quilting
    """
    from metapp.cli.fitting import table_of
    from metapp.evaluation.baseline_run import run_baseline
    from metapp.runs.plan import plan
    from metapp.runs.request import Request

    request = Request(
        app,
        "general",
        inputs or [],
        recipe=recipe,
        observe=observe,
        data=data,
        out=out_folder,
        seed=seed,
        device="cpu",
        quiet=quiet,
    )
    planned = plan(request)
    done = run_baseline(planned, method)
    if not (quiet or json):
        out().print(table_of(planned.app, method, done.records))
    if not quiet:
        say(f"{method} cannot {done.cannot}\nrecords: {done.folder}")
    if json:
        print_json(done.document())
