"""The commands of `metapp data` for photographs of a printed marker sheet."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metapp.cli.console import print_json
from metapp.cli.options import Json, Out, Overwrite, Quiet, check_new, takes
from metapp.extensions.capture.options import field_of_view
from metapp.runs.reporter import progress, say

if TYPE_CHECKING:
    from metapp.extensions.capture.markers.rectified import Set


class Paper(enum.StrEnum):
    """The paper that a sheet is printed on."""

    A4 = "a4"
    LETTER = "letter"


def markers(
    path: Annotated[Path, typer.Argument(metavar="OUT.pdf", help="File to write.")],
    opening: Annotated[
        int, typer.Option(min=4, max=13, metavar="CM", help="Side of the square opening, whole centimetres.")
    ] = 10,
    paper: Annotated[Paper, typer.Option("--page", help="The paper.")] = Paper.A4,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Write a marker sheet to print: a frame of markers round an opening, which is laid on a flat material.

    `metapp data rectify` finds the markers in photographs of it. Needs OpenCV, which metapp's extra
    `capture` installs.

    Example:
      metapp data markers sheet.pdf
    """
    from metapp.extensions.capture.markers.sheet import write_sheet
    from metapp.storage.files import suffixed

    path = suffixed(path, ".pdf")
    check_new(path, overwrite)
    write_sheet(path, opening, paper.value)
    if not quiet:
        say(f"{path}: a sheet with an opening of {opening} x {opening} cm; print it at 100 % and measure its ruler")
    if as_json:
        print_json({"path": str(path), "opening_cm": opening, "page": paper.value})


@dataclass(frozen=True)
class Rectify:
    """The arguments and options of `rectify`."""

    paths: Annotated[
        list[Path], typer.Argument(metavar="PHOTO...", help="Photographs with the sheet in view, or folders of them.")
    ]
    folder: Out
    size: Annotated[
        int,
        typer.Option(
            min=64, max=4096, metavar="PX", help="Greatest side of the pictures; never finer than the first photo."
        ),
    ] = 1024
    fov: Annotated[float, field_of_view("as EXIF says, else as the markers fit best")] = 0
    flash: Annotated[
        str, typer.Option(metavar="X,Y", help="Where the flash is beside the lens: cm right and up in the photo.")
    ] = "0,0"
    ruler: Annotated[
        float, typer.Option(min=5, max=20, metavar="CM", help="Measured length of the sheet's printed 10 cm ruler.")
    ] = 10
    quiet: Quiet = False
    as_json: Json = False


@takes(Rectify)
def rectify(options: Rectify) -> None:
    """Rectify photographs of a material in a marker sheet, and find where camera and flash were.

    Writes square pictures 00.png, 01.png, ... of the sheet's opening, that from nearest to straight above first,
    camera_pos.txt, light_pos.txt and image_size.txt: a folder for `metapp meta svbrdf_nonstationary DIR --observe
    photo`. Pictures in its folder found/ show what was found. Photos whose markers are missing or do not fit are
    skipped, each with a line. Needs OpenCV, which metapp's extra `capture` installs.

    Examples:
      metapp data rectify photos/ --out leaf
      metapp data rectify IMG_1.jpg IMG_2.jpg IMG_3.jpg --flash 1.2,0 --ruler 9.7 --out leaf
    """
    flash = _flash(options.flash)
    from data_tools.readers.photos import find_photos
    from metapp.extensions.capture.markers.rectified import FOUND, place, summary, write_set

    folder, quiet = options.folder, options.quiet
    if folder.is_dir() and any(folder.iterdir()):
        raise ValueError(f"{folder}: holds files, expected a new or empty folder to write to; choose another one.")
    photos, others = find_photos(options.paths)
    with progress("photos", len(photos), quiet=quiet) as bar:
        placed = place(
            photos,
            size=options.size,
            fov_rad=math.radians(options.fov),
            flash_cm=flash,
            ruler_cm=options.ruler,
            done=bar.advance,
        )
    for line in [*others, *placed.skipped]:
        say(f"warning: skipped: {line}")
    if any(flash) and len({photo.sighting.height > photo.sighting.width for photo in placed.photos}) > 1:
        say("warning: some photos are upright, some across: --flash is right and up in each as it is shown.")
    with progress("pictures", len(placed.photos), quiet=quiet) as bar:
        write_set(placed, folder, bar.advance)
    if not quiet:
        for number, photo in enumerate(placed.photos):
            say(f"{number:02}.png: {summary(photo)}")
        if placed.focal_mm:
            say(f"focal length: {placed.focal_mm:.1f} mm as of 35 mm film, found by the markers, as EXIF has none")
        side = f"{placed.side_cm:g} cm, {placed.size} px"
        say(f"{folder}: {len(placed.photos)} photos of {side} a side; look at what was found: {folder / FOUND}")
    if options.as_json:
        print_json(_document(folder, placed, others))


def _flash(text: str) -> tuple[float, float]:
    """An offset "X,Y" in cm."""
    try:
        x, y = map(float, text.split(","))
    except ValueError:
        x = y = math.nan
    if not math.hypot(x, y) <= 30:
        raise typer.BadParameter(
            f"'{text}', expected two numbers in cm, up to 30, such as 1.2,0.", param_hint="--flash"
        )
    return x, y


def _document(folder: Path, placed: Set, others: list[str]) -> dict[str, object]:
    """The document for scripts."""
    photos = [
        {
            "file": f"{number:02}.png",
            "source": str(photo.sighting.path),
            "markers": len(photo.sighting.markers),
            "error_px": photo.pose.error_px,
            "tilt_degrees": photo.pose.tilt,
            "camera_cm": photo.camera_cm.tolist(),
            "light_cm": photo.light_cm.tolist(),
        }
        for number, photo in enumerate(placed.photos)
    ]
    sizes = {"side_cm": placed.side_cm, "size": placed.size, "focal_mm": placed.focal_mm or None}
    return {"out": str(folder), **sizes, "photos": photos, "skipped": [*others, *placed.skipped]}
