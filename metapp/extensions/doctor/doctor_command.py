"""The command `metapp doctor`, which prints a report on the installation. `installation` makes the report."""

from __future__ import annotations

from metapp.cli.arguments import JsonFlag
from metapp.cli.console import print_json, standard_output


def doctor_command(
    json: JsonFlag = False,
) -> None:
    """Print what is installed and what fails: versions, device, compiler, cache, checkpoints, VGG, libLLVM."""
    from metapp.extensions.doctor.installation import examine_installation

    subjects = examine_installation()
    if json:
        print_json(subjects)
        return
    for name, report in subjects.items():
        colon, separator = (": ", "; ") if name == "checkpoints" else (" ", ", ")  # values of checkpoints are lists
        text = (
            separator.join(f"{key}{colon}{item}" for key, item in report.items())
            if isinstance(report, dict)
            else report
        )
        standard_output().print(f"{name:<11} {text}", soft_wrap=True)
