"""`metapp doctor`: a report on the installation."""

from __future__ import annotations

from metapp.cli.console import out, print_json
from metapp.cli.options import Json


def command(
    json: Json = False,
) -> None:
    """Print the installation: versions, device, compiler, cache, shipped checkpoints, VGG weights, libLLVM."""
    from metapp.extensions.doctor.installation import examine

    subjects = examine()
    if json:
        print_json(subjects)
        return
    for name, value in subjects.items():
        told, after = (": ", "; ") if name == "checkpoints" else (" ", ", ")  # these are lists
        text = after.join(f"{key}{told}{item}" for key, item in value.items()) if isinstance(value, dict) else value
        out().print(f"{name:<11} {text}", soft_wrap=True)
