"""`metapp doctor`: a report on the installation."""

from __future__ import annotations

from metapp.cli.arguments import JsonFlag
from metapp.cli.console import print_json, standard_output


def doctor_command(
    json: JsonFlag = False,
) -> None:
    """Print the installation: versions, device, compiler, cache, shipped checkpoints, VGG weights, libLLVM."""
    from metapp.extensions.doctor.installation import examine_installation

    subjects = examine_installation()
    if json:
        print_json(subjects)
        return
    for name, value in subjects.items():
        told, after = (": ", "; ") if name == "checkpoints" else (" ", ", ")  # these are lists
        text = after.join(f"{key}{told}{item}" for key, item in value.items()) if isinstance(value, dict) else value
        standard_output().print(f"{name:<11} {text}", soft_wrap=True)
