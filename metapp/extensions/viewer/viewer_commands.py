"""The commands `metapp view`, an interactive page of runs, and `metapp try`, a page of one fit of each application.

They turn options into calls of `runs_page`, which is imported only when a command runs, and say what was written.
"""

from __future__ import annotations

import time
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.arguments import FittedData, JsonFlag, Overwrite, Quiet, app_words, check_new_file
from metapp.cli.console import print_json
from metapp.options import BadOption
from metapp.registry import registry
from metapp.runs.reporter import format_number, progress, say
from metapp.runs.spec import application_named

OpenPage = Annotated[bool, typer.Option("--open/--no-open", help="Open the page in the browser.")]


def view_command(
    runs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[RUN]...",
            help="Folders of fits, of runs, or of several runs, whose newest is taken; default: runs.",
        ),
    ] = None,
    inputs: Annotated[
        list[Path] | None,
        typer.Option("--input", metavar="INPUT", help="Original input, if it has moved."),
    ] = None,
    task: Annotated[str, typer.Option(metavar="NAME", help="Show this task alone; default: all.")] = "",
    most: Annotated[int, typer.Option(min=1, help="Maximum number of tasks on the page.")] = 20,
    data: FittedData = None,
    out: Annotated[
        Path | None, typer.Option(dir_okay=False, help="Output file; default: view.html in the first RUN.")
    ] = None,
    overwrite: Overwrite = False,
    open_page: OpenPage = True,
    json: JsonFlag = False,
    quiet: Quiet = False,
) -> None:
    """Write an interactive HTML page of fits; several runs of the same tasks are shown side by side.

    Example: metapp view runs/brdf/meta runs/brdf/quickft
    """
    from metapp.extensions.viewer.runs_page import write_runs_page

    check_new_file(out, overwrite)
    page = write_runs_page(
        runs or [Path("runs")],
        out,
        inputs=inputs or (),
        data=data,
        task=task,
        most=most,
        quiet=quiet,
    )
    if open_page:
        webbrowser.open(page.resolve().as_uri())
    if json:
        print_json({"page": str(page), "bytes": page.stat().st_size})
    else:
        say(f"page: {page}, {page.stat().st_size / 1e6:.1f} MB")


def try_command(
    apps: Annotated[
        list[str] | None,
        typer.Argument(metavar="[APP]...", autocompletion=app_words, help="Applications; default: all."),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the inputs, fits and page.")] = Path("try"),
    recipe: Annotated[str, typer.Option(help="quick or full; default: full.")] = "",
    open_page: OpenPage = True,
    json: JsonFlag = False,
    quiet: Quiet = False,
) -> None:
    """Make a small synthetic input of each application, fit it by Meta, and open one page of all fits.

    texture and svbrdf_stationary need the VGG weights, see metapp data vgg; without them and without APP they are left
    out.

    Example: metapp try --out try
    """
    begin = time.perf_counter()
    from metapp.extensions.viewer.runs_page import fit_synthetic_input, write_runs_page

    runs, fits = list[Path](), []
    for app in apps or ():
        application_named(app)
    for app in apps or sorted(registry().applications):
        try:
            with progress(f"try {app}", quiet=quiet):  # the bars of the fit itself, of one input, are not shown
                run, fit = fit_synthetic_input(app, out, recipe)
        except ValueError as reason:
            if apps or not runs or isinstance(reason, BadOption):
                raise
            say(f"warning: {app} is left out: {reason}")
            continue
        runs.append(run)
        fits.append(fit)
        if not quiet:
            error = "" if fit["error"] is None else f"error {format_number(fit['error'], '.3f')}, "
            seconds = f"fitted in {format_number(fit['seconds'], '.3g')} s"
            whole_seconds = f"total {format_number(fit['whole_seconds'], '.1f')} s"
            say(f"{app}: {fit['name']}, {error}{seconds}, {whole_seconds}")
    if not quiet:
        say("page: rendering its pictures")
    page = write_runs_page(runs, out / "try.html", quiet=quiet)
    seconds_of_all = time.perf_counter() - begin
    if open_page:
        webbrowser.open(page.resolve().as_uri())
    if json:
        size = page.stat().st_size
        print_json({"page": str(page), "bytes": size, "seconds": seconds_of_all, "fits": fits})
    elif not quiet:
        say(f"page: {page}, {page.stat().st_size / 1e6:.1f} MB; all in {seconds_of_all:.0f} s")
