"""Arguments and options: commands made of annotated dataclasses, and what several commands have alike."""

from __future__ import annotations

import enum
import inspect
import os
from collections.abc import Callable, Iterable
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import typer

from metapp import door

RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, or of runs: the newest in it.")]
FittedData = Annotated[Path | None, typer.Option(help="Data set of the run, if it has moved.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object, the last line of output.")]
Options = TypeVar("Options")
Result = TypeVar("Result")


Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]
Seed = Annotated[int, typer.Option(metavar="S", min=0, max=2**63 - 1, help="Of all random draws.")]


def check_new(path: Path | None, overwrite: bool) -> None:
    """Refuse to write a file that is there, unless it may be replaced."""
    if path and not overwrite and os.path.lexists(path):
        raise typer.BadParameter(f"{path}: is there already, expected a new file; add --overwrite to replace it.")


def annotated(option: door.Option, *, given: bool = False, panel: str | None = None) -> object:
    """The annotation by which typer makes an option that an extension declares.

    Args:
        option: it.
        given: whether the value is None where the option is not given, rather than its default.
        panel: of --help.
    """
    limits: dict[str, Any] = {"min": option.low, "max": option.high} if type(option.default) in (int, float) else {}
    choices = enum.StrEnum("Choice", list(option.choices)) if option.choices else None
    kind: Any = choices or (Path if option.default is None else type(option.default))
    if option.several:
        kind = list[kind] | None
    elif given or option.default is None:
        kind = kind | None
    names = (option.flag,) if isinstance(option.default, bool) else ()
    return Annotated[
        kind, typer.Option(*names, metavar=option.metavar or None, help=option.help, rich_help_panel=panel, **limits)
    ]


def plain(value: object) -> object:
    """The value of an option: of a choice its word."""
    return value.value if isinstance(value, enum.Enum) else value


def takes(options: Callable[..., Options]) -> Callable[[Callable[..., Result]], Callable[..., Result]]:
    """Make a command of a function whose first parameter is a dataclass: its fields are arguments and options.

    Parameters that follow are options too.

    Args:
        options: the dataclass; its fields are annotated by `typer.Argument` and `typer.Option`.
    """
    names = [field.name for field in fields(options)]  # type: ignore[arg-type]  # a dataclass

    def decorate(function: Callable[..., Result]) -> Callable[..., Result]:
        def command(**values: Any) -> Result:
            own = {name: values.pop(name) for name in names}
            return function(options(**own), **values)

        return signed(command, function, [*parameters_of(options), *parameters_of(function)[1:]])

    return decorate


def extended(
    options: Iterable[door.Option], *, given: bool = True
) -> Callable[[Callable[..., Result]], Callable[..., Result]]:
    """Add options that extensions declare to a command, whose `**own` takes their values, of choices the words.

    Args:
        options: those of one name are one.
        given: whether it takes those alone that were given, without defaults.
    """
    by_name = {option.name: option for option in options}

    def decorate(function: Callable[..., Result]) -> Callable[..., Result]:
        def command(**values: Any) -> Result:
            own = {name: plain(values.pop(name)) for name in by_name}
            return function(**values, **{name: value for name, value in own.items() if not given or value is not None})

        more = [
            option_parameter(name, None if given else option.default, annotated(option, given=given))
            for name, option in by_name.items()
        ]
        return signed(command, function, [*parameters_of(function), *more])

    return decorate


def option_parameter(name: str, default: object, annotation: object) -> inspect.Parameter:
    """A parameter of a command."""
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def parameters_of(function: Callable[..., object]) -> list[inspect.Parameter]:
    """The parameters of a command or of a dataclass, with their annotations, but for `**`."""
    hints = get_type_hints(function, include_extras=True)
    signature = inspect.signature(function)
    return [
        option_parameter(name, parameter.default, hints[name])
        for name, parameter in signature.parameters.items()
        if parameter.kind is not parameter.VAR_KEYWORD
    ]


def signed(
    command: Callable[..., Result], like: Callable[..., object], parameters: list[inspect.Parameter]
) -> Callable[..., Result]:
    """A command that typer sees with these parameters, under the name and with the help of another function."""
    command.__name__, command.__doc__ = like.__name__, like.__doc__
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # what typer reads
    return command
