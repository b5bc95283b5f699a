"""The command `metapp doctor`, which prints a report on the installation. `installation` makes the report."""

from __future__ import annotations

import typer

from metapp.cli.arguments import JsonFlag
from metapp.cli.command_process import Exit
from metapp.cli.console import print_json, standard_output

SUBJECT_WIDTH = 11  # characters of the column of subjects


def doctor_command(
    json: JsonFlag = False,
) -> None:
    """Print what is installed and what fails: versions, device, compiler, cache, checkpoints, VGG, libLLVM.

    Optional packages are listed, too. The exit code is 1 if the last line names something that fails; weights of VGG
    that were not fetched yet do not.
    """
    from metapp.extensions.doctor.installation import FAILURES_KEY, examine_installation

    subjects = examine_installation()
    if json:
        print_json(subjects)
    else:
        for name, report in subjects.items():
            for line in _format_report(name, report):
                standard_output().print(line, soft_wrap=True)
    if subjects[FAILURES_KEY]:
        raise typer.Exit(Exit.FAILED)


def _format_report(subject: str, report: object) -> list[str]:
    """Return the report on a subject as lines, one for each of its items, below each other in columns."""
    if isinstance(report, list):
        texts = [", ".join(report) or "nothing"]
    elif isinstance(report, dict):
        width = max(map(len, report), default=0)
        texts = [f"{key:<{width}}  {item}" for key, item in report.items()]
    else:
        texts = [str(report)]
    return [f"{'' if number else subject:<{SUBJECT_WIDTH}} {text}" for number, text in enumerate(texts)]
