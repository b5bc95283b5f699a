"""The commands `metapp general|overfit|finetune|quickft|meta APP`, which fit tasks by one paradigm.

Only options and help are made here; :mod:`metapp.cli.fit_output`, which imports torch, does the work.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from metapp.application import Application
from metapp.cli.arguments import parameter, parameter_of, set_signature
from metapp.cli.command_process import pause_garbage_collection
from metapp.cli.command_tree import make_app_group
from metapp.options import INPUT, OUTPUT, options_by_name
from metapp.paradigms import PARADIGMS
from metapp.registry import registry
from metapp.runs.reporter import say
from metapp.runs.spec import DEFAULT_TASKS_HELP, RunOptions, Spec, parse_fit_options


def make_fit_command(paradigm: str, application: Application) -> Callable[..., None]:
    """Make the command that fits tasks of an application by a paradigm."""

    def command(inputs: list[Path] | None, json: bool, export: Sequence[str] | None, **values: Any) -> None:
        for option in ignored_options:
            if values.pop(option.name) not in (None, False):
                say(f"{option.flag}: {paradigm} does not use this option; it is ignored.")
        spec, options = parse_fit_options(application.name, paradigm, export=",".join(export or ()), **values)
        with pause_garbage_collection():
            from metapp.cli.fit_output import fit_and_print
        fit_and_print(spec, options, inputs or [], json=json)

    known_options = {**options_by_name(Spec), **options_by_name(RunOptions)}
    ignored_options = [known_options[name] for name in PARADIGMS[paradigm].ignored_options]
    exports = ", ".join(registry().exports_of(application))
    help_texts = {  # help that depends on the application; "" for an option that the application does not have
        "observe": known_options["observe"].help if application.observations else "",
        "export": f"{exports}; several separated by commas." if exports else "",
        "recipe": f"{', '.join(application.recipe_names)}; default: the one that suits the inputs, else full.",
        "rule": f"{', '.join(registry().rules)}; default: the recipe's.",
    }
    inputs_argument = typer.Argument(metavar="[INPUT]...", rich_help_panel=INPUT, help=_describe_inputs(application))
    json_option = typer.Option(
        "--json", rich_help_panel=OUTPUT, help="Print one JSON object as the last line of output."
    )
    parameters = [parameter("inputs", Annotated[list[Path] | None, inputs_argument])]
    for option in (*known_options.values(), *options_by_name(application.options.load()).values()):
        help_text = help_texts.get(option.name, option.help)
        is_hidden = not help_text or option in ignored_options
        changes = {"help": help_text, "hidden": is_hidden, "show_default": False, "rich_help_panel": option.panel}
        parameters.append(parameter_of(option, **changes))
    parameters.append(parameter("json", Annotated[bool, json_option], False))
    return set_signature(command, command, parameters)


def _describe_inputs(application: Application) -> str:
    """Return the help of INPUT: the files that the application reads."""
    formats = ", ".join(input_format.inputs for input_format in application.input_formats.values())
    return (
        f"What to fit: {formats}; folders of these; a data set; {DEFAULT_TASKS_HELP}."
        if formats
        else f"No files can be given; {DEFAULT_TASKS_HELP}."
    )


FIT_COMMANDS = {
    name: make_app_group(functools.partial(make_fit_command, name), entry.help) for name, entry in PARADIGMS.items()
}
