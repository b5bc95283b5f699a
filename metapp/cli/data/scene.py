"""`metapp data scene`: the second scene of illumination."""

from __future__ import annotations

from metapp.cli.console import print_json
from metapp.cli.data.convert import Quiet
from metapp.cli.options import Json
from metapp.runs.reporter import progress, say


def scene(quiet: Quiet = False, as_json: Json = False) -> None:
    """Build the second scene, under which illumination is judged.

    It is built once into the user's cache: Mitsuba finds how much of each direction's light reaches each pixel, in 20 s
    and 50 MB. The first fit that needs it builds it, too.
    """
    from metapp.rendering.second_scene.relighting import matrix_path, transfer

    file = matrix_path()
    there = file.is_file()
    with progress("second scene", quiet=quiet) as bar:
        transfer(report=bar.at)
    size = file.stat().st_size
    if not quiet:
        say(f"second scene: {'there already' if there else 'done'}: {file}, {size / 1e6:.1f} MB")
    if as_json:
        print_json({"path": str(file), "bytes": size, "there_already": there})
