"""Arguments and options of commands, made of dataclasses of options."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer

from metapp.cli import completion
from metapp.options import Declared, declared, parse

RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, or of runs: the newest in it.")]
FittedData = Annotated[Path | None, typer.Option(help="Data set of the run, if it has moved.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object, the last line of output.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]
Seed = Annotated[int, typer.Option(metavar="S", min=0, max=2**63 - 1, help="Of all random draws.")]
COMPLETIONS: dict[str, Callable[[str], list[str]]] = {
    "observe": completion.observations,
    "recipe": completion.recipes,
    "rule": completion.rules,
    "export": completion.exports,
    "device": completion.devices,
}


def check_new(path: Path | None, overwrite: bool) -> None:
    """Refuse to write a file that is there, unless it may be replaced."""
    if path and not overwrite and os.path.lexists(path):
        raise typer.BadParameter(f"{path}: is there already, expected a new file; add --overwrite to replace it.")


def takes(*classes: type) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a command of a function whose first parameters are instances of dataclasses of options.

    Args:
        classes: dataclasses of `metapp.options`, or whose fields are annotated by `typer.Argument` and `typer.Option`.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        def command(**values: Any) -> None:
            parts = [_instance(kind, {one.name: values.pop(one.name) for one in fields(kind)}) for kind in classes]
            function(*parts, **values)

        own = list(inspect.signature(function).parameters)[len(classes) :]
        parameters = [parameter for kind in classes for parameter in parameters_of(kind)]
        parameters += [parameter for parameter in parameters_of(function) if parameter.name in own]
        return signed(command, function, parameters)

    return decorate


def _instance(kind: type, values: dict[str, Any]) -> object:
    return parse(kind, values) if declared(kind) else kind(**values)


def parameters_of(source: Callable[..., object]) -> list[inspect.Parameter]:
    """The parameters of a function or of a dataclass, as typer reads them."""
    own = {one.name: one for one in declared(source)} if isinstance(source, type) else {}
    hints = get_type_hints(source, include_extras=True)
    return [
        parameter_of(own[name]) if name in own else parameter(name, hints[name], old.default)
        for name, old in inspect.signature(source).parameters.items()
        if old.kind is not old.VAR_KEYWORD
    ]


def parameter(name: str, annotation: object, default: object = None) -> inspect.Parameter:
    """A parameter of a command."""
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def parameter_of(one: Declared, **changes: Any) -> inspect.Parameter:
    """The parameter of a command for an option.

    Args:
        one: the option.
        changes: arguments of `typer.Option` that differ.
    """
    option, default = one.option, one.default or None  # 0 and "" say that an option is not given
    shown: dict[str, Any] = {"help": option.help, "show_default": bool(default)}
    shown |= {"metavar": option.metavar} if option.metavar else {}
    shown |= {"autocompletion": COMPLETIONS[one.name]} if one.name in COMPLETIONS else {}
    if option.argument:
        kind: Any = typer.Argument(**shown | changes)
    else:
        names = option.flags or (one.flag,)
        kind = typer.Option(*names, **shown | changes)
    annotation: Any = Annotated.__class_getitem__((_kind_of(one), kind))  # type: ignore[attr-defined]
    return parameter(one.name, annotation, default)


def _kind_of(one: Declared) -> Any:
    """The type that typer converts an option's words to."""
    kinds = get_args(one.kind) if isinstance(one.kind, UnionType) else (one.kind,)
    kind = kinds[0]
    if get_origin(kind) is tuple and get_args(kind)[0] is Path:
        return list[Path] | None
    if get_origin(kind) is tuple:
        return str | None  # parsed by the option
    if kind is bool:
        return bool
    return kind | None


def signed(
    command: Callable[..., None], like: Callable[..., object], parameters: list[inspect.Parameter]
) -> Callable[..., None]:
    """A command that typer sees with these parameters, under the name and with the help of another function."""
    command.__name__, command.__doc__ = like.__name__, like.__doc__
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # what typer reads
    return command
