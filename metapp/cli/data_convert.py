"""The commands of `metapp data` that convert files, one for each format that says how; and options that all share."""

from __future__ import annotations

import enum
import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from data_tools.formats import SPLIT, Command, Format, Setting
from metapp.cli.console import print_json
from metapp.cli.options import Json
from metapp.runs.convert import Converted, convert
from metapp.runs.reporter import say


class Split(enum.StrEnum):
    """Where tasks belong."""

    TRAIN = "train"
    TEST = "test"
    AUTO = "auto"


def check_folder(path: Path | None) -> Path | None:
    """Refuse a folder to write to that cannot be one, before any work is done."""
    for part in (path, *path.parents) if path else ():
        if part.exists() and not part.is_dir():
            raise typer.BadParameter(f"{part}: a file, expected a folder to write to; choose another one.")
    return path


Out = Annotated[
    Path, typer.Option("--out", "-o", metavar="DIR", callback=check_folder, help="Folder to write to; made if missing.")
]
SplitOption = Annotated[Split, typer.Option("--split", help=SPLIT)]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no summary.")]


def command_of(form: Format, about: Command) -> Callable[..., None]:
    """Make the command that converts files of a format; its options are the command's settings."""

    def command(paths: list[Path], folder: Path, split: Split, quiet: bool, as_json: bool, **settings: Any) -> None:
        chosen = {name: value.value if isinstance(value, enum.Enum) else value for name, value in settings.items()}
        conversion = form.conversion(paths, split.value, chosen)
        for line in conversion.remarks:
            say(f"warning: {line}")
        report(convert(conversion, paths, folder, split.value, quiet), quiet, as_json)

    split_option = Annotated[Split, typer.Option("--split", help=about.split_help)]
    keyword = functools.partial(inspect.Parameter, kind=inspect.Parameter.KEYWORD_ONLY)
    parameters = [
        keyword("paths", annotation=Annotated[list[Path], typer.Argument(metavar=about.metavar, help=about.paths)]),
        keyword("folder", annotation=Out),
        keyword("split", annotation=split_option, default=Split.AUTO),
        *(keyword(setting.name, annotation=_option(setting), default=setting.default) for setting in about.settings),
        keyword("quiet", annotation=Quiet, default=False),
        keyword("as_json", annotation=Json, default=False),
    ]
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    command.__name__, command.__doc__ = form.name, about.help
    return command


def _option(setting: Setting) -> Any:
    choices: Any = enum.StrEnum("Choice", list(setting.choices))  # type: ignore[misc]  # made at run time
    kind: Any = choices if setting.choices else type(setting.default)
    return Annotated[
        kind, typer.Option(min=setting.low, max=setting.high, metavar=setting.metavar or None, help=setting.help)
    ]


def report(done: Converted, quiet: bool, as_json: bool) -> None:
    """Say what was written, for a person and for scripts."""
    if not quiet:
        skipped = f"; {len(done.skipped)} skipped" if done.skipped else ""
        say(f"{done.app}: {len(done.train)} train + {len(done.test)} test tasks in {done.out}{skipped}")
    if as_json:
        print_json(done._asdict())
