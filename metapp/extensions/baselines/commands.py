"""`metapp baseline`: run a method of the baselines table on files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metapp import door
from metapp.cli import completion
from metapp.cli.console import out, print_json
from metapp.cli.options import Json, Seed, extended, takes
from metapp.runs import BadOption
from metapp.runs.reporter import progress, say
from metapp.runs.requests.options import all_shown_options, name_parts, options_of
from metapp.storage.text import meant

if TYPE_CHECKING:
    from metapp.runs.requests.plan import Plan
    from metapp.storage.records import Record


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
    of_presentations = all_shown_options()
    names = {
        option.name: option
        for application in door.offers(door.Application)
        for option, owner in options_of(application.name)
        if not isinstance(owner, door.Output)
    }
    return {name: option for name, option in names.items() if name not in of_presentations}


@extended(all_read_options().values())  # as for fits: how inputs are read, and at which resolution
@takes(Options)
def baseline(options: Options, **own: object) -> None:
    """Run a baseline without a neural network and evaluate it in the same way as fits.

    Example: metapp baseline texture wall.jpg --method quilting
    """
    from metapp.cli.fits.run import table_of
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
    cannot, folder, records, made = run(planned, options.method)
    if not (options.quiet or options.json):
        out().print(table_of(planned.app, options.method, records, made))
    if not options.quiet:
        say(f"{options.method} cannot {cannot}\nrecords: {folder}")
    if options.json:
        print_json({"method": options.method, "out": str(folder), "cannot": cannot, "tasks": records})


def run(plan: Plan, method: str) -> tuple[str, Path, list[Record], Path | None]:
    """Fit what a plan's request names, or its data set's test tasks, by one of the application's baselines.

    Returns:
        What it cannot do, the folder of the records, one a task, and the folder of pictures and maps, if any.

    Raises:
        BadOption: the application has no such baseline.
        ValueError: an input cannot be read or fitted, or there are no training tasks for a method that learns.
    """
    from metapp.apps import presentation_of
    from metapp.extensions.baselines import baselines_of
    from metapp.extensions.baselines.baseline import DrawsAnswers
    from metapp.extensions.baselines.fits import ENTRIES, fit_baselines, settings_of, training_folder, training_of
    from metapp.runs.inputs.sources import tasks_to_fit
    from metapp.runs.outputs.files import OUTPUTS, write_pictures
    from metapp.storage.records import RunFolder, file_name

    app, request = plan.app, plan.request
    methods = {baseline.name: baseline for baseline in baselines_of(app)}
    if method not in methods:
        names = ", ".join(methods) or f"another application: {app.name} has no method"
        raise BadOption(f"--method {method}: not one of {app.name}, expected {names}.{meant(method, methods)}")
    baseline, (tasks, label) = methods[method], tasks_to_fit(plan)
    source = training_folder(plan) if baseline.learns else None
    if baseline.learns and source is None:
        raise ValueError(f"{app.name} {method}: no training tasks to learn from; give a data set with --data.")
    words = [label, request.recipe, f"seed{request.seed}", *name_parts(app.name, plan.options), method, app.protocol]
    path = request.out / app.name / "baseline" / "-".join(filter(None, words))
    folder = RunFolder(path, settings_of(plan, baseline, source, label), ENTRIES, plan.origin())
    records, presentation = [], presentation_of(app)
    made = folder.path / OUTPUTS if isinstance(presentation, DrawsAnswers) else None
    with progress(method, len(tasks), quiet=request.quiet) as bar:
        fits = fit_baselines(plan, baseline, training_of(app, source), tasks, warm=False)
        for task, (record, kept, answer) in zip(tasks, fits, strict=True):
            folder.add(record, kept)
            if isinstance(presentation, DrawsAnswers):
                write_pictures(presentation.files_of(answer, task), folder.path / OUTPUTS / file_name(task.name))
            records.append(record)
            bar.advance(task.name)
    return baseline.cannot, folder.path, records, made
