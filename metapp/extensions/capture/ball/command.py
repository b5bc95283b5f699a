"""The command of `metapp data` for photographs of a mirror ball."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metapp.cli.console import print_json
from metapp.cli.options import Json, Out, Overwrite, Quiet, check_new, takes
from metapp.extensions.capture.options import field_of_view
from metapp.runs.reporter import progress, say

if TYPE_CHECKING:
    from metapp.extensions.capture.ball.capture import Capture


@dataclass(frozen=True)
class BallOptions:
    """The arguments and options of `ball`."""

    paths: Annotated[
        list[Path], typer.Argument(metavar="PHOTO...", help="Photographs of one ball, of different exposures.")
    ]
    folder: Out
    shutter: Annotated[
        str,
        typer.Option(
            metavar="T,T,...",
            help="Shutter times of the photos in their order, such as 1/20,1/60; default: EXIF.",
        ),
    ] = ""
    fov: Annotated[float, field_of_view("as EXIF says of uncropped photos, else far away")] = 0
    ball: Annotated[
        str, typer.Option(metavar="X,Y,RADIUS", help="Where the ball is, px from the upper left; default: it is found.")
    ] = ""
    rows: Annotated[int, typer.Option(min=32, max=1024, metavar="N", help="Rows of the map.")] = 128
    overwrite: Overwrite = False
    quiet: Quiet = False
    as_json: Json = False


@takes(BallOptions)
def ball(options: BallOptions) -> None:
    """Read the light around a mirror ball from photographs of it.

    The ball is found in each photo (borders may cut it), photos of several exposures are aligned by OpenCV and merged
    (after Debevec & Malik 1997, the camera's curve a power of sRGB's), and what the ball mirrors is unwrapped. Writes
    a data set for `metapp meta illumination --data DIR --observe photo`, the map DIR/NAME.exr, whose alpha says where
    it is seen and does not clip, and pictures of what was found in DIR/found/.

    Examples:
      metapp data ball a.jpg b.jpg c.jpg --shutter 1/20,1/60,1/160 --out garden
      metapp data ball IMG_1.jpg --fov 55 --rows 256 --out garden
    """
    from metapp.extensions.capture.ball.capture import capture
    from metapp.extensions.capture.ball.files import FOUND, write_capture
    from metapp.storage.shards import MANIFEST

    times, place = _times(options.shutter), _place(options.ball)
    folder, name = options.folder, options.folder.resolve().name
    check_new(folder / MANIFEST, options.overwrite)
    fov_rad = math.radians(options.fov)
    with progress("photos", len(options.paths), quiet=options.quiet) as bar:
        captured = capture(options.paths, times, fov_rad=fov_rad, ball=place, rows=options.rows, done=bar.advance)
    write_capture(name, options.paths, captured, folder, overwrite=options.overwrite)
    document = _document(options, captured)
    if not options.quiet:
        _say(document)
        say(f"{folder}: {name}.exr and a data set; look at what was found: {folder / FOUND}")
    if options.as_json:
        print_json(document)


def _times(text: str) -> tuple[float, ...]:
    from metapp.extensions.capture.ball.exposures import parsed

    try:
        return parsed(text) if text else ()
    except ValueError as error:
        raise typer.BadParameter(f"{error}.", param_hint="--shutter") from None


def _place(text: str) -> tuple[float, float, float] | None:
    """A circle "X,Y,RADIUS" in px."""
    if not text:
        return None
    try:
        x, y, radius = map(float, text.split(","))
    except ValueError:
        x = y = radius = math.nan
    if not (math.isfinite(x) and math.isfinite(y) and 0 < radius < math.inf):
        raise typer.BadParameter(
            f"'{text}', expected centre and radius in px, such as 210,205,180.", param_hint="--ball"
        )
    return x, y, radius


def _document(options: BallOptions, captured: Capture) -> dict[str, Any]:
    """The document for scripts."""
    photos = [
        {
            "source": str(path),
            "x": shot.ball.x,
            "y": shot.ball.y,
            "radius": shot.ball.radius,
            "score": shot.ball.score,
            "exposure": float(exposure),
            "residual": residual,
        }
        for path, shot, exposure, residual in zip(
            options.paths, captured.shots, captured.exposures, captured.residuals, strict=True
        )
    ]
    return {
        "out": str(options.folder),
        "power": captured.power,
        "chosen": str(options.paths[captured.chosen]),
        "seen": float(captured.certain[0].mean()),
        "clipped": float(captured.certain[1].mean()),
        "photos": photos,
    }


def _say(document: dict[str, Any]) -> None:
    """The same in words: a line a photograph and one of all."""
    photos = document["photos"]
    for photo in photos:
        line = (
            f"{Path(photo['source']).name}: ball at {photo['x']:.1f},{photo['y']:.1f}, radius {photo['radius']:.1f} px"
        )
        if len(photos) > 1:
            line += f", exposure {photo['exposure']:.4g}, {100 * photo['residual']:.1f} % from the merged radiance"
        say(line)
    curve = f"camera's curve: sRGB's to the power of {document['power']:.2f}; " if len(photos) > 1 else ""
    say(f"{curve}{document['seen']:.0%} of the texels seen, {document['clipped']:.1%} clipped")
