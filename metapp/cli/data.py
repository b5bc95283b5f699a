"""The commands of `metapp data` that convert files, join data sets and check them.

A conversion takes its help and its options from the converter of its format. The work itself is in
`metapp.runs.data_sets`, which is imported only when a command runs.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metapp.cli.arguments import JsonFlag, Out, Overwrite, Quiet, expand_options
from metapp.cli.command_process import Exit
from metapp.cli.console import print_json, standard_output
from metapp.options import Converter
from metapp.runs.reporter import say

if TYPE_CHECKING:
    from metapp.runs.data_sets.conversion import ConversionResult


def make_convert_command(name: str, converter: type[Converter]) -> Callable[..., None]:
    """Make the command that converts files of a format, with the converter's help and options."""

    def command(
        options: Converter,
        paths: Annotated[
            list[Path], typer.Argument(metavar="PATHS...", help="Files, and folders that are searched at any depth.")
        ],
        folder: Out,
        overwrite: Overwrite = False,
        quiet: Quiet = False,
        as_json: JsonFlag = False,
    ) -> None:
        from metapp.runs.data_sets.conversion import convert_files

        result = convert_files(
            name, paths, folder, options.split, options.arguments(), overwrite=overwrite, quiet=quiet
        )
        print_written_tasks(result, quiet, as_json)

    command.__doc__ = converter.__doc__
    return expand_options(converter)(command)


def print_written_tasks(result: ConversionResult, quiet: bool, as_json: bool) -> None:
    """Print how many tasks were written, in a sentence for people, as an object for scripts."""
    if not quiet:
        skipped = f"; {len(result.skipped)} skipped" if result.skipped else ""
        say(f"{result.app}: {len(result.train)} train + {len(result.test)} test tasks in {result.out}{skipped}")
    if as_json:
        print_json(result._asdict())


def join(
    folders: Annotated[list[Path], typer.Argument(metavar="DIRS...", help="Data sets of one application.")],
    folder: Out,
    alike: Annotated[
        bool, typer.Option("--alike", help="Training draws equally many tasks of each data set, whatever their sizes.")
    ] = False,
    overwrite: Overwrite = False,
    as_json: JsonFlag = False,
    quiet: Quiet = False,
) -> None:
    """Put several data sets into one; training tasks stay training tasks, test tasks stay test tasks.

    Tensors that not all tasks hold, such as reference relightings of synthetic materials, are left out. Tasks whose
    name is in several data sets get the name of their data set in front.

    Example:
      metapp data join drawn photographed --alike --out joint
    """
    from metapp.runs.data_sets.joining import join_data_sets

    result = join_data_sets(folders, folder, alike=alike, overwrite=overwrite, quiet=quiet)
    print_written_tasks(result, quiet, as_json)


def check(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a data set, with its manifest.json.")],
    as_json: JsonFlag = False,
) -> None:
    """Verify a data set.

    Compare files with their SHA-256 hashes; look for missing and foreign files, for tensors that the application cannot
    use (missing, or of another shape or type) and for values that are not finite.
    Print the content, then the problems, one a line; the exit code is 1 if there are any.

    Example:
      metapp data check merl
    """
    from metapp.runs.data_sets.checking import check_data_set

    try:
        report = check_data_set(folder)
    except ValueError as error:
        if not as_json:
            raise
        print_json({"app": None, "folder": str(folder), "problems": [str(error)]})
        raise typer.Exit(Exit.FAILED) from None
    counts, problems = report.counts, report.problems
    if as_json:
        document = {"app": report.app, "folder": str(folder), **counts, "bytes": report.bytes}
        print_json({**document, "units": report.units, "problems": problems})
    else:
        tasks = f"{counts['train']} train + {counts['test']} test tasks"
        lines = [f"{folder}: {report.app}, {tasks}, {report.bytes / 1e6:,.1f} MB"]
        lines += [f"  {key}: {unit}" for key, unit in report.units.items()]
        standard_output().print("\n".join(lines), soft_wrap=True)
        for problem in problems:
            say(f"problem: {problem}")
        standard_output().print(f"{len(problems)} problem{'s' * (len(problems) != 1)}" if problems else "no problems")
    if problems:
        raise typer.Exit(Exit.FAILED)
