"""Arguments and options of commands, made of dataclasses of options, and the words that shells complete.

Nothing large is imported, since a shell waits while a word is completed.
"""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer

from metapp.application import Application
from metapp.options import Option, options_by_name, parse_options
from metapp.registry import registry

# environment variables in which shells pass the line to complete
COMPLETION_LINE_VARIABLES = ("COMP_WORDS", "_TYPER_COMPLETE_ARGS")
WordCompleter = Callable[[str], list[str]]


def _make_completer(list_names: Callable[[], Iterable[str]], separator: str = "") -> WordCompleter:
    """Make the function that typer calls for the names that begin like the word on the command line.

    Args:
        list_names: returns all names.
        separator: the character between several names in one word; "" if a word is one name.
    """

    def complete(incomplete: str) -> list[str]:
        before, mark, last = incomplete.rpartition(separator) if separator else ("", "", incomplete)
        return [before + mark + name for name in dict.fromkeys(list_names()) if name.startswith(last)]

    return complete


def app_names() -> list[str]:
    """Return the names of all applications, sorted."""
    return sorted(registry().applications)


def _names_of_apps(names: Callable[[Application], Iterable[str]]) -> Callable[[], Iterable[str]]:
    """Restrict names to the applications in the line that is completed.

    An application counts where its name stands alone or in the path of a run. Without one, all applications count.

    Args:
        names: application -> its names.
    """

    def list_names() -> Iterable[str]:
        # the whole line is searched, as typer cannot parse a line whose last option has no value yet
        line, apps = " ".join(os.environ.get(name, "") for name in COMPLETION_LINE_VARIABLES), app_names()
        line_apps = [app for app in apps if re.search(rf"(?<![\w-]){app}(?![\w-])", line)]
        return (name for app in line_apps or apps for name in names(registry().applications[app]))

    return list_names


app_words = _make_completer(app_names)
fit_export_names = _names_of_apps(lambda application: [*registry().exports_of(application)])
export_words = _make_completer(lambda: (*fit_export_names(), *registry().file_exports))
baseline_words = _make_completer(_names_of_apps(lambda application: application.baselines))
COMPLETION_WORDS = {  # completers of the values of options, by the option's name
    "observe": _make_completer(_names_of_apps(lambda application: application.observations)),
    "recipe": _make_completer(_names_of_apps(lambda application: application.recipe_names)),
    "rule": _make_completer(lambda: registry().rules),
    "export": _make_completer(fit_export_names, ","),
    "which": _make_completer(lambda: (*registry().tables, "all")),
}


# placeholders in help for values of options that state no placeholder of their own
DEFAULT_METAVARS = {int: "N", str: "NAME", Path: "DIR"}


def check_new_file(path: Path | None, overwrite: bool) -> None:
    """Refuse to write a file that exists, unless it may be replaced.

    Raises:
        BadParameter: the file exists.
    """
    if path and not overwrite and os.path.lexists(path):
        raise typer.BadParameter(f"{path}: is there already, expected a new file; add --overwrite to replace it.")


def check_out_folder(path: Path | None) -> Path | None:
    """Refuse a folder to write to that cannot be one, before any work is done.

    Raises:
        BadParameter: the folder, or a parent of it, is a file.
    """
    for parent in (path, *path.parents) if path else ():
        if parent.exists() and not parent.is_dir():
            raise typer.BadParameter(f"{parent}: a file, expected a folder to write to; choose another one.")
    return path


RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, or of runs, whose newest is taken.")]
FittedData = Annotated[Path | None, typer.Option(help="Data set of the run, if it has moved.")]
JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object as the last line of output.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace existing files.")]
Seed = Annotated[int, typer.Option(metavar="S", min=0, max=2**63 - 1, help="Seed of all random draws.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print no progress, no table and no messages.")]
Out = Annotated[
    Path,
    typer.Option("--out", "-o", metavar="DIR", callback=check_out_folder, help="Folder to write to; made if missing."),
]


def expand_options(kind: type) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that makes a command of a function whose first argument is a dataclass of options.

    The command has an option for each field of the dataclass, before the function's further arguments.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        def command(**values: Any) -> None:
            options = {name: values.pop(name) for name in options_by_name(kind)}
            function(parse_options(kind, options), **values)

        option_parameters = [parameter_of(option) for option in options_by_name(kind).values()]
        hints = get_type_hints(function, include_extras=True)
        further_arguments = list(inspect.signature(function).parameters.values())[1:]
        return set_signature(
            command,
            function,
            option_parameters
            + [parameter(argument.name, hints[argument.name], argument.default) for argument in further_arguments],
        )

    return decorate


def parameter(name: str, annotation: object, default: object = None) -> inspect.Parameter:
    """Return a parameter of a command, as typer reads it."""
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def parameter_of(option: Option, **changes: Any) -> inspect.Parameter:
    """Return the parameter of a command for an option.

    Args:
        option: an option that :func:`metapp.options.options_by_name` returned.
        changes: arguments of `typer.Option` that replace those of the option.
    """
    default = option.default or None  # 0 and "" stand for an option that is not given
    arguments: dict[str, Any] = {"help": option.help, "show_default": bool(default)}
    arguments["metavar"] = option.metavar or DEFAULT_METAVARS.get(option.kinds[0])
    if words := COMPLETION_WORDS.get(option.name, _make_completer(lambda: option.choices) if option.choices else None):
        arguments["autocompletion"] = words
    names = [option.flag, *([f"-{option.short}"] if option.short else [])]
    kind = option.kinds[0]
    if get_origin(kind) is tuple:  # a list of paths, or of words; anything else is one word; the option parses words
        element = get_args(kind)[0]
        kind = list[Path] if element is Path else list[str] if get_origin(element) is tuple else str
    if option.name == "export":  # may also be given several times
        kind = list[str]
    annotation = kind if kind is bool else kind | None
    return parameter(option.name, Annotated[annotation, typer.Option(*names, **arguments | changes)], default)


def value_placeholder(param: Any) -> str:
    """Return the word that stands for the value of a parameter in help."""
    return str(param.metavar or param.name.upper())


def set_signature(
    command: Callable[..., None], documented_function: Callable[..., object], parameters: list[inspect.Parameter]
) -> Callable[..., None]:
    """Give a command the parameters that typer reads, and the name and help of another function.

    Args:
        command: the command, which is changed.
        documented_function: the function whose name and docstring the command takes.
        parameters: the parameters.

    Returns:
        The command.
    """
    command.__name__, command.__doc__ = documented_function.__name__, documented_function.__doc__
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # what typer reads
    return command
