"""`metapp baseline`: run a method of the baselines table on files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from metapp.apps.exemplar.options import ExemplarOptions
from metapp.cli.arguments import baseline_words, parameter, parameter_of, set_signature
from metapp.cli.command_tree import make_app_group
from metapp.cli.console import print_json, standard_output
from metapp.names import protocols_of
from metapp.options import FIT, INPUT, OUTPUT, app_options_class, options_by_name
from metapp.registry import registry
from metapp.runs.fit_options import DEFAULT_TASKS_HELP, FitOptions, fit_options
from metapp.runs.reporter import say

BASELINE_OPTION_NAMES = ("data", "observe", "recipe", "seed", "out", "quiet")  # of the options of fits


def make_baseline_command(app: str) -> Callable[..., None]:
    """The command that runs a method on tasks of an application."""
    names = ", ".join(registry().baselines.of(app))

    def command(inputs: list[Path] | None, method: str, json: bool, **values: Any) -> None:
        run_and_print(fit_options(app, "general", inputs or (), device="cpu", **values), method, json=json)

    files = typer.Argument(
        metavar="[INPUT]...",
        rich_help_panel=INPUT,
        help=f"Files of the application or folders; {DEFAULT_TASKS_HELP}.",
    )
    methods = typer.Option(
        metavar="NAME",
        rich_help_panel=FIT,
        autocompletion=baseline_words,
        help=f"{names}.",
    )
    as_json = typer.Option("--json", rich_help_panel=OUTPUT, help="Print one JSON object, the last line of output.")
    taken = [name for name in BASELINE_OPTION_NAMES if name != "observe" or protocols_of(app)]
    general = [options_by_name(FitOptions)[name] for name in taken]
    own = [
        option
        for option in options_by_name(app_options_class(app)).values()
        if option.panel != OUTPUT or is_size_option(app, option.name)
    ]
    parameters = [parameter("json", Annotated[bool, as_json], False)]
    parameters += [parameter("inputs", Annotated[list[Path] | None, files])]
    parameters += [
        parameter_of(option, show_default=False, rich_help_panel=option.panel) for option in (*general, *own)
    ]
    parameters += [parameter("method", Annotated[str, methods], "nearest")]
    return set_signature(command, command, parameters)


baseline_group = make_app_group(
    make_baseline_command, "Run a baseline without a neural network and evaluate it in the same way as fits."
)


def is_size_option(app: str, option: str) -> bool:
    """Return True if an option is the size of files that tile, which methods of an application may take."""
    return option == "size" and issubclass(app_options_class(app), ExemplarOptions)


def run_and_print(options: FitOptions, method: str, *, json: bool) -> None:
    """Run a method on the inputs of options, and print its table."""
    from metapp.extensions.baselines.baseline_run import run_baseline

    done = run_baseline(options, method)
    if not (options.quiet or json):
        standard_output().print(done.shown(), soft_wrap=len(done.records) == 1)
    if not options.quiet:
        say(f"{method} cannot {done.cannot}\nfits: {done.path}")
    if json:
        print_json({"method": method, "out": str(done.path), "cannot": done.cannot, "tasks": done.records})
