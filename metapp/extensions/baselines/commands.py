"""`metapp baseline`: run a method of the baselines table on files."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from metapp.apps.exemplar.options import ExemplarOptions
from metapp.cli.commands import app_group
from metapp.cli.console import out, print_json
from metapp.cli.options import baseline_words, parameter, parameter_of, signed
from metapp.names import did_you_mean, protocols_of
from metapp.options import FIT, INPUT, OUTPUT, BadOption, declared, options_of
from metapp.registry import registry
from metapp.runs.options import TASKS, FitOptions, fit_options
from metapp.runs.reporter import progress, say

TAKEN = ("data", "observe", "recipe", "seed", "out", "quiet")  # of the options of fits


def command_of(app: str) -> Callable[..., None]:
    """The command that runs a method on tasks of an application."""
    names = ", ".join(registry().baselines.of(app))

    def command(inputs: list[Path] | None, method: str, json: bool, **values: Any) -> None:
        fit(fit_options(app, "general", inputs or (), device="cpu", **values), method, json=json)

    files = typer.Argument(
        metavar="[INPUT]...",
        rich_help_panel=INPUT,
        help=f"Files of the application or folders; {TASKS}.",
    )
    methods = typer.Option(
        metavar="NAME",
        rich_help_panel=FIT,
        autocompletion=baseline_words,
        help=f"{names}.",
    )
    as_json = typer.Option("--json", rich_help_panel=OUTPUT, help="Print one JSON object, the last line of output.")
    taken = [name for name in TAKEN if name != "observe" or protocols_of(app)]
    general = [declared(FitOptions)[name] for name in taken]
    own = [
        option for option in declared(options_of(app)).values() if option.panel != OUTPUT or is_size(app, option.name)
    ]
    parameters = [parameter("json", Annotated[bool, as_json], False)]
    parameters += [parameter("inputs", Annotated[list[Path] | None, files])]
    parameters += [
        parameter_of(option, show_default=False, rich_help_panel=option.panel) for option in (*general, *own)
    ]
    parameters += [parameter("method", Annotated[str, methods], "nearest")]
    return signed(command, command, parameters)


baseline = app_group(command_of, "Run a baseline without a neural network and evaluate it in the same way as fits.")


def is_size(app: str, option: str) -> bool:
    """Return True if an option is the size of files that tile, which methods of an application may take."""
    return option == "size" and issubclass(options_of(app), ExemplarOptions)


def fit(options: FitOptions, method: str, *, json: bool) -> None:
    """Run a method on the inputs of options, and print its table."""
    from metapp.cli.fit import line_of, table_of
    from metapp.extensions.baselines import baselines_of
    from metapp.extensions.baselines.fits import ENTRIES, fit_baselines, settings_of, training_folder
    from metapp.runs.inputs.sources import content_of, read_tasks, sources_to_fit
    from metapp.runs.outputs.files import write_pictures
    from metapp.runs.run import Run
    from metapp.storage.fits import RunFolder

    run = Run.of(options)
    app, options = run.app, run.options
    methods = {baseline.name: baseline for baseline in baselines_of(app)}
    if method not in methods:
        names = ", ".join(methods) or f"another application: {app.name} has no method"
        raise BadOption(f"--method {method}: not one of {app.name}, expected {names}.{did_you_mean(method, methods)}")
    if run.presenter.size and not methods[method].sizes:
        sized = ", ".join(name for name, other in methods.items() if other.sizes) or "none"
        raise BadOption(f"--size: {method} writes files of one size, expected a method that makes others: {sized}.")
    baseline, (sources, label) = methods[method], sources_to_fit(run)
    tasks = read_tasks(sources)
    if baseline.learns and training_folder(run, baseline, make=True) is None:
        raise ValueError(f"{app.name} {method}: no training tasks to learn from; give a data set with --data.")
    path = run.path(label, f"baseline-{method}")
    kept = RunFolder(path, settings_of(run, baseline, label), ENTRIES)
    records = []
    with progress(method, len(tasks), quiet=options.quiet) as bar:
        fits = fit_baselines(run, baseline, tasks, warm=False)
        for task, (record, picture, written) in zip(tasks, fits, strict=True):
            record |= {"content": content_of(task), "origin": run.origin(options.paths)}
            files = run.presenter.answer_pictures(written(run.presenter.size), task)
            records.append(kept.write(record, picture, functools.partial(write_pictures, files)))
            bar.advance(task.name)
    if not (options.quiet or json):
        shown = table_of(run.presenter, method, records) if len(records) > 1 else line_of(run.presenter, records[0])
        out().print(shown, soft_wrap=len(records) == 1)
    if not options.quiet:
        say(f"{method} cannot {baseline.cannot}\nfits: {path}")
    if json:
        print_json({"method": method, "out": str(path), "cannot": baseline.cannot, "tasks": records})
