"""The command `metapp doctor`, which prints a report on the installation. `installation` makes the report."""

from __future__ import annotations

import typer

from metapp.cli.arguments import JsonFlag
from metapp.cli.command_process import Exit
from metapp.cli.console import print_json, standard_output


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
            standard_output().print(f"{name:<11} {_format_report(report)}", soft_wrap=True)
    if subjects[FAILURES_KEY]:
        raise typer.Exit(Exit.FAILED)


def _format_report(report: object) -> str:
    """Return the report on a subject as one line."""
    if isinstance(report, list):
        return ", ".join(report) or "nothing"
    if not isinstance(report, dict):
        return str(report)
    has_phrases = any(" " in item for item in report.values())
    colon, separator = (": ", "; ") if has_phrases else (" ", ", ")
    return separator.join(f"{key}{colon}{item}" for key, item in report.items())
