"""The commands of `metapp data` that convert files, one for each format that says how; and options that all share."""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.console import print_json
from metapp.cli.options import Json, Overwrite, parameters_of, signed
from metapp.options import parse
from metapp.registry import SPLIT, Format
from metapp.runs.inputs.convert import Converted, convert
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
SplitOption = Annotated[Split, typer.Option("--split", metavar="train|test|auto", help=SPLIT)]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no summary.")]


def command_of(name: str, form: Format) -> Callable[..., None]:
    """Make the command that converts files of a format; with the options that it declares."""

    def command(
        paths: Annotated[
            list[Path], typer.Argument(metavar="PATHS...", help="Files, and folders that are searched at any depth.")
        ],
        folder: Out,
        split: Split = Split.AUTO,
        overwrite: Overwrite = False,
        quiet: Quiet = False,
        as_json: Json = False,
        **own: object,
    ) -> None:
        options = vars(parse(kind, own))
        done = convert(name, form, paths, folder, split.value, options, overwrite=overwrite, quiet=quiet)
        report(done, quiet, as_json)

    kind = form.options or NoOptions
    command.__name__, command.__doc__ = name, form.help
    command.__annotations__ |= {
        "split": Annotated[Split, typer.Option("--split", metavar="train|test|auto", help=form.split_help)],
    }
    return signed(command, command, [*parameters_of(command), *parameters_of(kind)])


@dataclass(frozen=True)
class NoOptions:
    """A conversion without options of its own."""


def report(done: Converted, quiet: bool, as_json: bool) -> None:
    """Say what was written, for a person and for scripts."""
    if not quiet:
        skipped = f"; {len(done.skipped)} skipped" if done.skipped else ""
        say(f"{done.app}: {len(done.train)} train + {len(done.test)} test tasks in {done.out}{skipped}")
    if as_json:
        print_json(done._asdict())
