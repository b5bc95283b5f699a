"""`metapp general|overfit|finetune|quickft|meta APP`: fit tasks by one paradigm."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from metapp.cli.arguments import parameter, parameter_of, set_signature
from metapp.cli.command_tree import make_app_group
from metapp.cli.console import pause_garbage_collection
from metapp.names import exports_of, input_formats, protocols_of, recipe_names
from metapp.options import INPUT, OUTPUT, app_options_class, options_by_name
from metapp.paradigms import PARADIGMS
from metapp.registry import registry
from metapp.runs.fit_options import DEFAULT_TASKS_HELP, FitOptions, fit_options
from metapp.runs.reporter import say


def make_fit_command(paradigm: str, app: str) -> Callable[..., None]:
    """The command that fits tasks of an application by a paradigm."""

    def command(inputs: list[Path] | None, json: bool, export: Sequence[str] | None, **values: Any) -> None:
        for option in unused:
            if values.pop(option.name) not in (None, False):
                say(f"{option.flag}: {paradigm} has no use for it; the option is ignored.")
        options = fit_options(app, paradigm, inputs or (), export=",".join(export or ()), **values)
        with pause_garbage_collection():
            from metapp.cli.fit_output import fit_and_print
        fit_and_print(options, json=json)

    unused = [options_by_name(FitOptions)[name] for name in PARADIGMS[paradigm].ignored_options]
    exports = ", ".join(exports_of(app))
    texts = {  # that differ between applications; "" of an option that one does not have
        "observe": options_by_name(FitOptions)["observe"].help if protocols_of(app) else "",
        "export": f"{exports}; several separated by commas." if exports else "",
        "recipe": f"{', '.join(recipe_names(app))}; default: full, the best that ships.",
        "rule": f"{', '.join(registry().rules)}; or parts joined by +, such as adam+curvature; default: the recipe's.",
    }
    files = typer.Argument(metavar="[INPUT]...", rich_help_panel=INPUT, help=_inputs(app))
    as_json = typer.Option("--json", rich_help_panel=OUTPUT, help="Print one JSON object, the last line of output.")
    parameters = [parameter("inputs", Annotated[list[Path] | None, files])]
    for option in (*options_by_name(FitOptions).values(), *options_by_name(app_options_class(app)).values()):
        text = texts.get(option.name, option.help)
        hidden = not text or option in unused
        shown = {"help": text, "hidden": hidden, "show_default": False, "rich_help_panel": option.panel}
        parameters.append(parameter_of(option, **shown))
    parameters.append(parameter("json", Annotated[bool, as_json], False))
    return set_signature(command, command, parameters)


def _inputs(app: str) -> str:
    forms = ", ".join(form.inputs for form in input_formats(app).values())
    return (
        f"What to fit: {forms}; folders of these; a data set; {DEFAULT_TASKS_HELP}."
        if forms
        else f"No file; {DEFAULT_TASKS_HELP}."
    )


FIT_COMMANDS = {
    name: make_app_group(functools.partial(make_fit_command, name), entry.help) for name, entry in PARADIGMS.items()
}
