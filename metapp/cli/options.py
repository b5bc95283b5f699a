"""Arguments and options: commands made of annotated dataclasses, and what several commands have alike."""

from __future__ import annotations

import enum
import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import typer

from metapp import door

RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, or its record.jsonl.")]
FittedData = Annotated[Path | None, typer.Option(help="Data set of the run, if it has moved.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object as the last line of standard output.")]
Options = TypeVar("Options")
Result = TypeVar("Result")


def field_of_view(unsaid: str) -> Any:
    """The option for a camera's field of view in degrees; its help ends with what 0 means."""
    words = f"Field of view along the photos' shorter side; 0: {unsaid}."
    return typer.Option(min=0, max=150, metavar="DEGREES", help=words)


def annotated(option: door.Option, *, given: bool = False, **more: Any) -> Any:
    """The annotation by which typer makes an option that an extension declares.

    Args:
        option: it.
        given: whether the value is None where the option is not given, rather than its default.
        more: for `typer.Option`.
    """
    limits: dict[str, Any] = {"min": option.low, "max": option.high} if type(option.default) in (int, float) else {}
    choices = enum.StrEnum("Choice", list(option.choices)) if option.choices else None
    kind: Any = choices or (Path if option.default is None else type(option.default))
    if option.several:
        kind = list[kind] | None
    elif given or option.default is None:
        kind = kind | None
    names = (option.flag,) if isinstance(option.default, bool) else ()
    return Annotated[kind, typer.Option(*names, metavar=option.metavar or None, help=option.help, **(limits | more))]


def plain(value: Any) -> Any:
    """The value of an option: of a choice its word."""
    return value.value if isinstance(value, enum.Enum) else value


def takes(options: Callable[..., Options]) -> Callable[[Callable[[Options], Result]], Callable[..., Result]]:
    """Make a command of a function of one object: each field of its dataclass is an argument or option, as annotated.

    Args:
        options: the dataclass; its fields are annotated by `typer.Argument` and `typer.Option`.
    """

    def decorate(function: Callable[[Options], Result]) -> Callable[..., Result]:
        def command(**values: Any) -> Result:
            return function(options(**values))

        hints = get_type_hints(options, include_extras=True)
        parameters = [
            inspect.Parameter(
                field.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if field.default is MISSING else field.default,
                annotation=hints[field.name],
            )
            for field in fields(options)  # type: ignore[arg-type]  # a dataclass
        ]
        command.__name__, command.__doc__, command.__annotations__ = function.__name__, function.__doc__, hints
        command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # what typer reads
        return command

    return decorate
