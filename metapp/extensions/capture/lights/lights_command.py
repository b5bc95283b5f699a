"""The command `metapp data lights`, which reads the light's directions off photographs of a glossy ball.

Only arguments and messages are made here; :mod:`metapp.extensions.capture.lights.found_lights` does the work.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.arguments import JsonFlag, Overwrite, Quiet, check_new_file, expand_options
from metapp.cli.console import print_json
from metapp.extensions.capture.lights.lights_options import LightsOptions
from metapp.runs.inputs.refusals import check_files_of_user
from metapp.runs.reporter import say
from metapp.storage.files import add_suffix
from metapp.storage.folders import FOUND_FOLDER


@expand_options(LightsOptions)
def lights_command(
    options: LightsOptions,
    paths: Annotated[list[Path], typer.Argument(metavar="PHOTO...", help="Photographs, or folders of them.")],
    path: Annotated[Path, typer.Option("--out", "-o", metavar="FILE.lp", help="Text of directions to write.")],
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: JsonFlag = False,
) -> None:
    """Read the light's direction of each photograph off the highlight on one or two glossy balls.

    The camera stands still and the lamp moves (RTI). The balls are found by all photographs; a black, shiny one that
    stands beside the material and fills 100 px or more is best. Two balls also tell how far the lamp is. Photographs
    without a highlight, with several of similar strength, or whose shading says otherwise are left out, each with a
    line. Writes FILE.lp, a line "name x y z" for each photograph, FILE.balls, where the balls are, and the picture
    found/FILE.png beside them. FILE.lp beside its photographs makes their folder an input of
    `metapp meta svbrdf_nonstationary DIR`.

    Examples:
      metapp data lights coin/ --out coin/coin.lp
      metapp data lights coin/ --ball 310,2200,140 --ball 3700,190,138 --out coin/coin.lp
      metapp data lights dome_with_ball/ --names coin/ --out coin/coin.lp
    """
    path = add_suffix(path, ".lp")
    check_new_file(path, overwrite)
    for photo_path in [*paths, *filter(None, [options.names])]:
        check_files_of_user(photo_path, "photographs by a camera that stands still")
    from metapp.extensions.capture.lights.found_lights import find_lights

    found = find_lights(paths, options, path, quiet=quiet)
    if not quiet:
        for ball in found["balls"]:
            say(f"ball at {ball['x']:.1f},{ball['y']:.1f}, radius {ball['radius']:.1f} px: {ball['photos']} highlights")
        if len(found["balls"]) > 1:
            far = f"far away: balls differ by {found['parallax_degrees']:.1f} degrees"
            near = f"{found['distance_widths']:.2f} picture widths away" if found["distance_widths"] else far
            say(
                f"lamp: {near}, {found['parallax_degrees']:.1f} degrees of parallax, noise {found['noise_degrees']:.1f}"
            )
        elevations = [math.degrees(math.asin(photo["direction"][2])) for photo in found["photos"]]
        count = f"{len(elevations)} of {len(elevations) + len(found['left_out'])} photos"
        say(f"{path}: {count}, lights {min(elevations):.0f} to {max(elevations):.0f} degrees high")
        say(f"look at what was found: {path.parent / FOUND_FOLDER / path.stem}.png")
    if as_json:
        print_json({"out": str(path), **found})
