"""The command `metapp baseline`, which runs a method of the table of baselines on files.

Only arguments and help are made here; :mod:`metapp.extensions.baselines.baseline_run`, which imports torch, does the
work.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from metapp.application import Application
from metapp.apps.exemplar.options import ExemplarOptions
from metapp.cli.arguments import baseline_words, parameter, parameter_of, set_signature
from metapp.cli.command_tree import make_app_group
from metapp.cli.console import print_json, standard_output
from metapp.options import FIT, INPUT, OUTPUT, options_by_name
from metapp.runs.reporter import say
from metapp.runs.spec import DEFAULT_TASKS_HELP, RunOptions, Spec, parse_fit_options

BASELINE_OPTION_NAMES = (
    "data",
    "observe",
    "recipe",
    "seed",
    "export",
    "out",
    "quiet",
)  # options of fits that methods take, too


def make_baseline_command(application: Application) -> Callable[..., None]:
    """Return the command that runs a method on tasks of an application."""
    method_names = ", ".join(application.baselines)

    def command(inputs: list[Path] | None, method: str, json: bool, export: list[str] | None, **values: Any) -> None:
        forms = ",".join(export or ())
        spec, options = parse_fit_options(application.name, "general", device="cpu", export=forms, **values)
        run_and_print(spec, options, inputs or [], method, json=json)

    inputs_argument = typer.Argument(
        metavar="[INPUT]...",
        rich_help_panel=INPUT,
        help=f"Files that the application reads, or folders of them; {DEFAULT_TASKS_HELP}.",
    )
    method_option = typer.Option(
        metavar="NAME",
        rich_help_panel=FIT,
        autocompletion=baseline_words,
        help=f"{method_names}.",
    )
    json_option = typer.Option(
        "--json", rich_help_panel=OUTPUT, help="Print one JSON object as the last line of output."
    )
    option_names = [name for name in BASELINE_OPTION_NAMES if name != "observe" or application.observations]
    known_options = {**options_by_name(Spec), **options_by_name(RunOptions)}
    general_options = [known_options[name] for name in option_names]
    own_options = [
        option
        for option in options_by_name(application.options.load()).values()
        if option.panel != OUTPUT or is_size_option(application, option.name)
    ]
    parameters = [parameter("json", Annotated[bool, json_option], False)]
    parameters += [parameter("inputs", Annotated[list[Path] | None, inputs_argument])]
    parameters += [
        parameter_of(option, show_default=False, rich_help_panel=option.panel)
        for option in (*general_options, *own_options)
    ]
    parameters += [parameter("method", Annotated[str, method_option], "nearest")]
    return set_signature(command, command, parameters)


baseline_group = make_app_group(
    make_baseline_command, "Run a baseline without a neural network and evaluate it in the same way as fits."
)


def is_size_option(application: Application, option: str) -> bool:
    """Return True if an option is the size of files that tile, which methods of an application may take."""
    return option == "size" and issubclass(application.options.load(), ExemplarOptions)


def run_and_print(spec: Spec, options: RunOptions, paths: Sequence[Path], method: str, *, json: bool) -> None:
    """Run a method on inputs, and print a table of its fits, or one JSON object."""
    from metapp.extensions.baselines.baseline_run import run_baseline

    baseline_run = run_baseline(spec, options, paths, method)
    if not (options.quiet or json):
        standard_output().print(baseline_run.describe(), soft_wrap=len(baseline_run.fits) == 1)
    if not options.quiet:
        lines = [f"{method} cannot {baseline_run.cannot}", f"fits: {baseline_run.path}", *baseline_run.export_lines]
        say("\n".join(lines))
    if json:
        print_json(
            {
                "method": method,
                "out": str(baseline_run.path),
                "cannot": baseline_run.cannot,
                "tasks": [{**fit.document(), "folder": str(fit.folder)} for fit in baseline_run.fits],
            }
        )
