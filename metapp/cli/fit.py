"""`metapp general|overfit|finetune|quickft|meta APP`: fit tasks by one paradigm."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from metapp.cli.commands import app_group
from metapp.cli.console import importing
from metapp.cli.options import parameter, parameter_of, signed
from metapp.names import exports_of, inputs_of, protocols_of, recipe_names
from metapp.options import INPUT, OUTPUT, declared, options_of
from metapp.paradigms import PARADIGMS
from metapp.registry import registry
from metapp.runs.options import TASKS, FitOptions, fit_options
from metapp.runs.reporter import say


def command_of(paradigm: str, app: str) -> Callable[..., None]:
    """The command that fits tasks of an application by a paradigm."""

    def command(inputs: list[Path] | None, json: bool, export: Sequence[str] | None, **values: Any) -> None:
        for option in unused:
            if values.pop(option.name) not in (None, False):
                say(f"{option.flag}: {paradigm} has no use for it; the option is ignored.")
        options = fit_options(app, paradigm, inputs or (), export=",".join(export or ()), **values)
        with importing():
            from metapp.cli.fitting import fit
        fit(options, json=json)

    unused = [declared(FitOptions)[name] for name in PARADIGMS[paradigm].ignores]
    exports = ", ".join(exports_of(app))
    texts = {  # that differ between applications; "" of an option that one does not have
        "observe": declared(FitOptions)["observe"].help if protocols_of(app) else "",
        "export": f"{exports}; several separated by commas." if exports else "",
        "recipe": f"{', '.join(recipe_names(app))}; default: full, the best that ships.",
        "rule": f"{', '.join(registry().rules)}; or parts joined by +, such as adam+curvature; default: the recipe's.",
    }
    files = typer.Argument(metavar="[INPUT]...", rich_help_panel=INPUT, help=_inputs(app))
    as_json = typer.Option("--json", rich_help_panel=OUTPUT, help="Print one JSON object, the last line of output.")
    parameters = [parameter("inputs", Annotated[list[Path] | None, files])]
    for option in (*declared(FitOptions).values(), *declared(options_of(app)).values()):
        text = texts.get(option.name, option.help)
        hidden = not text or option in unused
        shown = {"help": text, "hidden": hidden, "show_default": False, "rich_help_panel": option.panel}
        parameters.append(parameter_of(option, **shown))
    parameters.append(parameter("json", Annotated[bool, as_json], False))
    return signed(command, command, parameters)


def _inputs(app: str) -> str:
    forms = ", ".join(form.inputs for form in inputs_of(app).values())
    return f"What to fit: {forms}; folders of these; a data set; {TASKS}." if forms else f"No file; {TASKS}."


COMMANDS = {name: app_group(functools.partial(command_of, name), entry.help) for name, entry in PARADIGMS.items()}
