"""The command of `metapp data` for photographs of a mirror ball."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metapp.cli.console import print_json
from metapp.cli.options import Json, Out, Overwrite, Quiet, check_new, takes
from metapp.networks.options import Layer, fov
from metapp.options import Option
from metapp.runs.reporter import progress, say

if TYPE_CHECKING:
    from metapp.extensions.capture.ball.capture import Capture
    from metapp.learning.task import Task

UNITS = {
    "photos": "the ball as a camera far away sees it, display values, uint8 0..255 [1, 3, 64, 64]; black outside",
    "seen": "lat-long radiance that the ball mirrors, linear Rec.709 [3, H, 2 H], rows from the top (+y), the middle "
    "column looks to +z, to the camera; 1 is white in `photos`; 0 where nothing is seen",
    "certain": "[2, H, 2 H] in [0, 1]: how far a texel is seen unclipped; how far it is seen but white in all photos, "
    "so that `seen` is a lower bound",
}


def circle_of(text: str) -> tuple[float, ...]:
    """Centre and radius of "X,Y,RADIUS", px; ValueError for another form."""
    try:
        x, y, radius = map(float, text.split(","))
    except ValueError:
        x = y = radius = math.nan
    if not (math.isfinite(x) and math.isfinite(y) and 0 < radius < math.inf):
        raise ValueError("expected centre and radius in px, such as 210,205,180")
    return x, y, radius


@dataclass(frozen=True)
class BallOptions:
    """The options of `ball` about photographs and map."""

    shutter: Annotated[
        str, Option("Shutter times of the photos in their order, such as 1/20,1/60; auto: EXIF's.", "T,T,...")
    ] = "auto"
    fov: Annotated[float, fov("EXIF's of uncropped photos, else far away")] = 0.0
    ball: Annotated[
        tuple[float, ...],
        Option("Where the ball is, px from the upper left; default: it is found.", "X,Y,RADIUS", parse=circle_of),
    ] = ()
    rows: Annotated[int, Option("Rows of the map, 32 to 1024.", "N", low=32, high=1024)] = 128
    layer: Layer = ""


@takes(BallOptions)
def ball(
    options: BallOptions,
    paths: Annotated[
        list[Path], typer.Argument(metavar="PHOTO...", help="Photographs of one ball, of different exposures.")
    ],
    folder: Out,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Read the light around a mirror ball from photographs of it.

    The ball is found in each photo (borders may cut it), photos of several exposures are aligned by OpenCV and merged
    (after Debevec & Malik 1997, the camera's curve a power of sRGB's), and the light in the ball is unwrapped. Writes
    a data set for `metapp meta illumination DIR`, the map DIR/NAME.exr, whose alpha says where
    it is seen and does not clip, and pictures of the balls that were found in DIR/found/.

    Examples:
      metapp data ball a.jpg b.jpg c.jpg --shutter 1/20,1/60,1/160 --out garden
      metapp data ball IMG_1.jpg --fov 55 --rows 256 --out garden
    """
    from metapp.extensions.capture.ball.capture import capture
    from metapp.storage.folders import FOUND, MANIFEST, check_files_of_user

    check_new(folder / MANIFEST, overwrite)
    for path in paths:
        check_files_of_user(path, "a photograph of a ball")
    name, fov_rad = folder.resolve().name, math.radians(options.fov)
    with progress("photos", len(paths), quiet=quiet) as bar:
        captured = capture(paths, options.shutter, options.rows, fov_rad, options.ball, bar.advance, options.layer)
        bar.name("writing the map and pictures of what was found")
        _write(name, paths, captured, folder, options.layer, overwrite=overwrite)
    figures = zip(paths, captured.balls, captured.exposures.tolist(), captured.residuals, strict=True)
    photos: list[dict[str, Any]] = [
        {"source": str(path), "x": ball.x, "y": ball.y, "radius": ball.radius, "score": ball.score}
        | {"exposure": exposure, "residual": residual}
        for path, ball, exposure, residual in figures
    ]
    seen, clipped = captured.data["certain"].mean((1, 2)).tolist()
    for photo in () if quiet else photos:
        place = f"ball at {photo['x']:.1f},{photo['y']:.1f}, radius {photo['radius']:.1f} px"
        off = f", exposure {photo['exposure']:.4g}, {photo['residual']:.1%} from the merged radiance"
        say(f"{Path(photo['source']).name}: {place}{off * (len(paths) > 1)}")
    if not quiet:
        curve = f"camera's curve: sRGB's to the power of {captured.power:.2f}; " * (len(paths) > 1)
        say(f"{curve}{seen:.0%} of the texels seen, {clipped:.1%} clipped")
        say(f"{folder}: {name}.exr and a data set; look at what was found: {folder / FOUND}")
    if as_json:
        map_ = {"chosen": str(paths[captured.chosen]), "seen": seen, "clipped": clipped}
        print_json({"out": str(folder), "power": captured.power, **map_, "photos": photos})


def _write(name: str, paths: list[Path], captured: Capture, folder: Path, layer: str, *, overwrite: bool) -> None:
    """Write a data set of one task, its map NAME.exr and found/*.png."""
    import numpy as np
    import torch

    from data_tools.readers.image_files import read_pixels
    from metapp.extensions.capture.photos import write_found
    from metapp.learning.task import Task
    from metapp.storage.folders import FOUND
    from metapp.storage.images import write_exr
    from metapp.storage.shards import write_shard

    notes = {
        "made_by": "metapp data ball",
        "photos": [path.name for path in paths],
        "exposures": captured.exposures.tolist(),
        "power": captured.power,
        "files": [FOUND, f"{name}.exr"],
    }
    turn = np.linspace(0, 2 * np.pi, 361)

    def task() -> Iterator[tuple[Task, str, Path]]:
        yield Task(name, captured.data), "test", paths[captured.chosen]
        for path, ball in zip(paths, captured.balls, strict=True):
            contour = ball.to_px(np.stack([np.cos(turn), np.sin(turn)])).T
            write_found(read_pixels(path, layer), [(contour, "lime")], folder / FOUND / f"{path.stem}.png")
        light = torch.cat([captured.data["seen"], captured.data["certain"][:1]])
        write_exr(light.permute(1, 2, 0), folder / f"{name}.exr")

    write_shard(folder, "illumination", UNITS, task(), notes, overwrite=overwrite)
