"""Arguments and options of commands, made of dataclasses of options, and the words that shells complete.

Nothing large is imported, since shells wait for words.
"""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer

from metapp.names import app_names, exports_of, protocols_of, recipe_names, rule_words
from metapp.options import Option, options_by_name, parse_options
from metapp.registry import registry

COMPLETION_LINE_VARIABLES = ("COMP_WORDS", "_TYPER_COMPLETE_ARGS")  # where shells leave the line that is completed
WordCompleter = Callable[[str], list[str]]


def _words(names: Callable[[], Iterable[str]], between: str = "") -> WordCompleter:
    """The function that typer asks for names that begin as a word does; `between` may stand between several."""

    def complete(incomplete: str) -> list[str]:
        before, mark, last = incomplete.rpartition(between) if between else ("", "", incomplete)
        return [before + mark + name for name in dict.fromkeys(names()) if name.startswith(last)]

    return complete


def _of_apps(names: Callable[[str], Iterable[str]]) -> Callable[[], Iterable[str]]:
    """Names that belong to the applications which the line has so far, also as a part of a run's path; else to all."""

    def of_line() -> Iterable[str]:
        # by the whole line: typer parses none whose last option has no value yet
        line, apps = " ".join(os.environ.get(name, "") for name in COMPLETION_LINE_VARIABLES), app_names()
        named = [app for app in apps if re.search(rf"(?<![\w-]){app}(?![\w-])", line)]
        return (name for app in named or apps for name in names(app))

    return of_line


app_words = _words(app_names)
export_words = _words(lambda: (*_of_apps(exports_of)(), *registry().file_exports))
baseline_words = _words(_of_apps(lambda app: registry().baselines.of(app)))
COMPLETION_WORDS = {  # of options by name
    "observe": _words(_of_apps(protocols_of)),
    "recipe": _words(_of_apps(recipe_names)),
    "rule": _words(rule_words, "+"),
    "export": _words(_of_apps(exports_of), ","),
    "which": _words(lambda: (*registry().tables, "all")),
}


DEFAULT_METAVARS = {int: "N", str: "NAME", Path: "DIR"}  # of options that name none


def check_new_file(path: Path | None, overwrite: bool) -> None:
    """Refuse to write a file that is there, unless it may be replaced."""
    if path and not overwrite and os.path.lexists(path):
        raise typer.BadParameter(f"{path}: is there already, expected a new file; add --overwrite to replace it.")


def check_out_folder(path: Path | None) -> Path | None:
    """Refuse a folder to write to that cannot be one, before any work is done."""
    for part in (path, *path.parents) if path else ():
        if part.exists() and not part.is_dir():
            raise typer.BadParameter(f"{part}: a file, expected a folder to write to; choose another one.")
    return path


RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, or of runs: the newest in it.")]
FittedData = Annotated[Path | None, typer.Option(help="Data set of the run, if it has moved.")]
JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object, the last line of output.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]
Seed = Annotated[int, typer.Option(metavar="S", min=0, max=2**63 - 1, help="Of all random draws.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no table, no messages.")]
Out = Annotated[
    Path,
    typer.Option("--out", "-o", metavar="DIR", callback=check_out_folder, help="Folder to write to; made if missing."),
]


def expand_options(kind: type) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a command of a function whose first parameter is an instance of this dataclass of options."""

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        def command(**values: Any) -> None:
            options = {name: values.pop(name) for name in options_by_name(kind)}
            function(parse_options(kind, options), **values)

        own = [parameter_of(option) for option in options_by_name(kind).values()]
        hints = get_type_hints(function, include_extras=True)
        others = list(inspect.signature(function).parameters.values())[1:]
        return set_signature(
            command, function, own + [parameter(one.name, hints[one.name], one.default) for one in others]
        )

    return decorate


def parameter(name: str, annotation: object, default: object = None) -> inspect.Parameter:
    """A parameter of a command."""
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def parameter_of(option: Option, **changes: Any) -> inspect.Parameter:
    """The parameter of a command for an option.

    Args:
        option: of a dataclass, as of `options_by_name`.
        changes: arguments of `typer.Option` that differ.
    """
    default = option.default or None  # 0 and "" say that an option is not given
    shown: dict[str, Any] = {"help": option.help, "show_default": bool(default)}
    shown["metavar"] = option.metavar or DEFAULT_METAVARS.get(option.kinds[0])
    if words := COMPLETION_WORDS.get(option.name, _words(lambda: option.choices) if option.choices else None):
        shown["autocompletion"] = words
    names = [option.flag, *([f"-{option.short}"] if option.short else [])]
    kind = option.kinds[0]
    if get_origin(kind) is tuple:  # of paths, or what the option parses
        kind = list[Path] if get_args(kind)[0] is Path else str
    if option.name == "export":  # which may be given several times, too
        kind = list[str]
    annotation = kind if kind is bool else kind | None
    return parameter(option.name, Annotated[annotation, typer.Option(*names, **shown | changes)], default)


def value_placeholder(param: Any) -> str:
    """Return the word that stands for the value of a parameter in help."""
    return str(param.metavar or param.name.upper())


def set_signature(
    command: Callable[..., None], like: Callable[..., object], parameters: list[inspect.Parameter]
) -> Callable[..., None]:
    """A command that typer sees with these parameters, under the name and with the help of another function."""
    command.__name__, command.__doc__ = like.__name__, like.__doc__
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # what typer reads
    return command
