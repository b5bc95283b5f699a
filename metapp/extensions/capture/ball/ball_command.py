"""The command `metapp data ball`, which reads the light around a mirror ball from photographs.

Only arguments and messages are made here; :mod:`metapp.extensions.capture.ball.light_files` does the work.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from metapp.cli.arguments import JsonFlag, Out, Overwrite, Quiet, check_new_file, expand_options
from metapp.cli.console import print_json
from metapp.extensions.capture.ball.ball_options import BallOptions
from metapp.runs.inputs.refusals import check_files_of_user
from metapp.runs.reporter import say
from metapp.storage.folders import FOUND_FOLDER, MANIFEST


@expand_options(BallOptions)
def ball_command(
    options: BallOptions,
    paths: Annotated[
        list[Path], typer.Argument(metavar="PHOTO...", help="Photographs of one ball, of different exposures.")
    ],
    folder: Out,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: JsonFlag = False,
) -> None:
    """Read the light around a mirror ball from photographs of it.

    The ball is found in each photo (borders may cut it). Photos of several exposures are aligned by OpenCV and merged
    (after Debevec & Malik 1997; the camera's curve is a power of sRGB's), and the light in the ball is unwrapped.
    Writes a data set for `metapp meta illumination DIR`, the map DIR/NAME.exr, whose alpha says where the light is
    seen and does not clip, and pictures of the balls that were found in DIR/found/.

    Examples:
      metapp data ball a.jpg b.jpg c.jpg --shutter 1/20,1/60,1/160 --out garden
      metapp data ball IMG_1.jpg --fov 55 --rows 256 --out garden
    """
    check_new_file(folder / MANIFEST, overwrite)
    for path in paths:
        check_files_of_user(path, "a photograph of a ball")
    from metapp.extensions.capture.ball.light_files import write_light

    captured = write_light(paths, options, folder, overwrite=overwrite, quiet=quiet)
    figures = zip(paths, captured.balls, captured.exposures.tolist(), captured.residuals, strict=True)
    photos: list[dict[str, Any]] = [
        {"source": str(path), "x": ball.x, "y": ball.y, "radius": ball.radius, "score": ball.score}
        | {"exposure": exposure, "residual": residual}
        for path, ball, exposure, residual in figures
    ]
    seen, clipped = captured.data["certain"].mean((1, 2)).tolist()
    for photo in () if quiet else photos:
        position = f"ball at {photo['x']:.1f},{photo['y']:.1f}, radius {photo['radius']:.1f} px"
        exposure_text = f", exposure {photo['exposure']:.4g}, {photo['residual']:.1%} from the merged radiance"
        say(f"{Path(photo['source']).name}: {position}{exposure_text * (len(paths) > 1)}")
    if not quiet:
        curve_text = f"camera's curve: sRGB's to the power of {captured.power:.2f}; " * (len(paths) > 1)
        say(f"{curve_text}{seen:.0%} of the texels seen, {clipped:.1%} clipped")
        found = folder / FOUND_FOLDER
        say(f"{folder}: {folder.resolve().name}.exr and a data set; look at what was found: {found}")
    if as_json:
        map_entries = {"chosen": str(paths[captured.reference_index]), "seen": seen, "clipped": clipped}
        print_json({"out": str(folder), "power": captured.power, **map_entries, "photos": photos})
