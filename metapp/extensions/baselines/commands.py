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
from metapp.runs import BadOption
from metapp.runs.reporter import progress, say
from metapp.runs.requests.options import all_shown_options, name_parts, options_of
from metapp.storage.text import meant


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
            help="Such as quilting of texture; an unknown name lists the methods of APP.",
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
    of_pictures = all_shown_options()
    names = {
        option.name: option
        for application in door.offers(door.Application)
        for option, owner in options_of(application.name)
        if not isinstance(owner, door.Output)
    }
    return {name: option for name, option in names.items() if name not in of_pictures}


@extended(all_read_options().values())  # as for fits: how inputs are read, and at which resolution
@takes(Options)
def baseline(options: Options, **own: object) -> None:
    """Run a baseline without a neural network and evaluate it in the same way as fits.

    Example: metapp baseline texture wall.jpg --method quilting
    """
    from metapp.cli.fits.run import table_of
    from metapp.extensions.baselines import baselines_of
    from metapp.extensions.baselines.fits import ENTRIES, fit_baselines, settings_of, training_folder
    from metapp.runs.inputs.sources import tasks_to_fit
    from metapp.runs.outputs.files import OUTPUTS, write_pictures
    from metapp.runs.requests.plan import plan
    from metapp.runs.requests.request import Request
    from metapp.storage.records import RunFolder, file_name

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
    planned, method = plan(request), options.method
    app, request = planned.app, planned.request
    methods = {baseline.name: baseline for baseline in baselines_of(app)}
    if method not in methods:
        names = ", ".join(methods) or f"another application: {app.name} has no method"
        raise BadOption(f"--method {method}: not one of {app.name}, expected {names}.{meant(method, methods)}")
    baseline, (tasks, label) = methods[method], tasks_to_fit(planned)
    if baseline.learns and training_folder(planned, baseline) is None:
        raise ValueError(f"{app.name} {method}: no training tasks to learn from; give a data set with --data.")
    words = [label, request.recipe, f"seed{request.seed}", *name_parts(app.name, planned.options), method, app.protocol]
    path = request.out / app.name / "baseline" / "-".join(filter(None, words))
    folder = RunFolder(path, settings_of(planned, baseline, label), ENTRIES, planned.origin())
    records, made = [], None
    with progress(method, len(tasks), quiet=request.quiet) as bar:
        fits = fit_baselines(planned, baseline, tasks, warm=False)
        for task, (record, kept, answer) in zip(tasks, fits, strict=True):
            folder.add(record, kept)
            if pictures := app.answer_pictures(answer, task):
                made = folder.path / OUTPUTS
                write_pictures(pictures, made / file_name(task.name))
            records.append(record)
            bar.advance(task.name)
    if not (options.quiet or options.json):
        out().print(table_of(app, method, records, made))
    if not options.quiet:
        say(f"{method} cannot {baseline.cannot}\nrecords: {folder.path}")
    if options.json:
        print_json({"method": method, "out": str(folder.path), "cannot": baseline.cannot, "tasks": records})
