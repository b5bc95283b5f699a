"""The commands of `metapp data` for photographs of a flat material, with a printed marker sheet or without."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metapp.cli.console import print_json
from metapp.cli.options import Json, Out, Overwrite, Quiet, check_new, takes
from metapp.networks.options import fov
from metapp.options import Option
from metapp.runs.reporter import progress, say

if TYPE_CHECKING:
    from metapp.extensions.capture.markers.attempt import Attempt

ONE_PLACE_SIDES = 0.1  # sides of the square, within which cameras see the same


@dataclass(frozen=True)
class SheetOptions:
    """The options of `markers` about the sheet."""

    opening: Annotated[int, Option("Side of the square opening, 4 to 13 whole centimetres.", "CM", low=4, high=13)] = 10
    page: Annotated[str, Option("The paper.", "a4|letter", choices=("a4", "letter"))] = "a4"


@takes(SheetOptions)
def markers(
    options: SheetOptions,
    path: Annotated[Path, typer.Argument(metavar="OUT.pdf", help="File to write.")],
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
    from metapp.extensions.capture.markers.sheet_page import write_sheet
    from metapp.storage.files import suffixed

    path, opening = suffixed(path, ".pdf"), options.opening
    check_new(path, overwrite)
    write_sheet(path, opening, options.page)
    if not quiet:
        say(f"{path}: a sheet with an opening of {opening} x {opening} cm; print it at 100 % and measure its ruler")
    if as_json:
        print_json({"path": str(path), "opening_cm": opening, "page": options.page})


def offset_of(text: str) -> tuple[float, ...]:
    """An offset "X,Y" in cm; ValueError for another form."""
    try:
        x, y = map(float, text.split(","))
    except ValueError:
        x = y = math.nan
    if not math.hypot(x, y) <= 30:
        raise ValueError("expected two numbers in cm, up to 30, such as 1.2,0")
    return x, y


@dataclass(frozen=True)
class RectifyOptions:
    """The options of `rectify` about photographs and pictures."""

    size: Annotated[
        int, Option("Greatest side of the pictures; never finer than the first photo.", "PX", low=64, high=4096)
    ] = 1024
    fov: Annotated[float, fov("EXIF's, else as markers or points fit best")] = 0.0
    flash: Annotated[
        tuple[float, ...],
        Option(
            "Where the flash is beside the lens: cm right and up in the photo; default: 0,0.", "X,Y", parse=offset_of
        ),
    ] = ()
    ruler: Annotated[float, Option("Measured length of the sheet's printed 10 cm ruler.", "CM", low=5.0, high=20.0)] = (
        10.0
    )


@takes(RectifyOptions)
def rectify(
    options: RectifyOptions,
    paths: Annotated[list[Path], typer.Argument(metavar="PHOTO...", help="Photographs, or folders of them.")],
    folder: Out,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Rectify hand-held flash photographs of a flat material, and find the positions of camera and flash.

    Of photos that show a marker sheet, rectifies the sheet's opening. Where none shows a marker, photos are registered
    by the material's own features: one from about straight above, the others up to 30 degrees aside, all
    aimed at one place. The straightest is the reference; the square is the largest that all show, and lengths are in
    its sides. Where a table round the sample is seen, which lies lower, it is the largest on the sample.
    Writes square pictures 00.png, 01.png, ..., that from nearest to straight above first, camera_pos.txt,
    light_pos.txt and image_size.txt: a folder for `metapp meta svbrdf_nonstationary DIR`. Pictures in its folder
    found/ show the markers or points found. Photos that do not fit are skipped, each with a line, and shown by
    found/skipped.png; where none is left, DIR.failed.png beside the folder shows what was found in them. Needs OpenCV,
    which metapp's extra `capture` installs.

    Examples:
      metapp data rectify photos/ --out leaf
      metapp data rectify IMG_1.jpg IMG_2.jpg IMG_3.jpg --flash 1.2,0 --ruler 9.7 --out leaf
    """
    from data_tools.readers.photos import find_images
    from metapp.extensions.capture.markers.attempt import Attempt
    from metapp.extensions.capture.markers.rectified import write_set
    from metapp.extensions.capture.markers.sample import find_sample
    from metapp.storage.folders import FAILED, FOUND, check_files_of_user

    if folder.is_dir() and any(folder.iterdir()):
        raise ValueError(f"{folder}: holds files, expected a new or empty folder to write to; choose another one.")
    photos_alone = [path for path in paths if not path.name.endswith(FAILED)]  # which a shell's *.png names, too
    for path in photos_alone or paths:
        check_files_of_user(path, "photographs of a flat material")
    in_paths = [find_images(path) for path in photos_alone]
    names = list({file.resolve(): file for files, _ in in_paths for file in files}.values())
    attempt, failed = Attempt(), _failed_picture(folder)
    try:
        with progress("photos", len(names), quiet=quiet) as bar:
            fov_rad, done, begin = math.radians(options.fov), bar.advance, bar.name
            cameras, focal_mm, skipped, kept = find_sample(names, fov_rad, options.ruler, done, begin, attempt.show)
    except ValueError as error:
        drawn = _draw(attempt, names, str(error), failed, quiet=quiet)
        raise ValueError(f"{str(error).removesuffix('.')}; see {failed}." if drawn else str(error)) from None
    skipped = [*(line for _, lines in in_paths for line in lines), *skipped]
    for line in skipped:
        say(f"warning: skipped: {line}")
    (right, up), first = options.flash or (0.0, 0.0), cameras[0].sighting
    if (right or up) and not first.sheet:
        raise ValueError(
            "--flash: cm, but no photo shows the marker sheet, which tells how long they are; leave it out."
        )
    if not first.sheet and not quiet:
        say(f"no markers: {len(cameras)} photos registered by their own features; lengths are in sides of the square")
    if line := _line_about_cut(kept):
        say(f"{'' if kept else 'warning: '}{folder}: {line}")
    if (right or up) and len({sighting.height > sighting.width for sighting, *_ in cameras}) > 1:
        say("warning: some photos are upright, some across: --flash is right and up in each as it is shown.")
    lights_cm = [camera.beside_cm(right, up) for camera in cameras]
    if line := line_about_views([(camera.place_cm / first.opening_cm).tolist() for camera in cameras]):
        say(f"warning: {folder}: {line}")
    unit, marks = ("cm", "markers") if first.sheet else ("sides", "points")
    size = min(options.size, int(first.opening_cm * first.scales()[0]))  # no finer than the one with most detail
    with progress("pictures", len(cameras), quiet=quiet) as bar:
        write_set(cameras, lights_cm, size, folder, bar.advance)
    failed.unlink(missing_ok=True)  # of an earlier command
    left = [name for name in names if name not in [camera.sighting.path for camera in cameras]]
    if left:
        _draw(attempt, left, "skipped:", folder / FOUND / "skipped.png", quiet=quiet)
    photos: list[dict[str, Any]] = [
        {
            "file": f"{number:02}.png",
            "source": str(camera.sighting.path),
            marks: len(camera.sighting.markers),
            "reference": camera.sighting.reference,
            "error_px": camera.error_px,
            "aside_degrees": camera.aside_degrees,
            "tilt_degrees": camera.tilt_degrees,
            "camera": camera.place_cm.tolist(),
            "light": light_cm.tolist(),
        }
        for number, (camera, light_cm) in enumerate(zip(cameras, lights_cm, strict=True))
    ]
    if not quiet:
        for photo in photos:
            off = "the reference" if photo["reference"] else f"error {photo['error_px']:.2f} px"
            found = f"{Path(photo['source']).name}, {photo[marks]} {marks}, {off}"
            away = f"camera {math.hypot(*photo['camera']):.1f} {unit} away, {photo['aside_degrees']:.0f} degrees aside"
            say(f"{photo['file']}: {found}, {away}, tilted by {photo['tilt_degrees']:.0f}")
        if focal_mm:
            say(f"focal length: {focal_mm:.1f} mm as of 35 mm film, found by the {marks}, as EXIF has none")
        side = f"{first.opening_cm:g} cm, {size}" if first.sheet else f"{size}"
        say(f"{folder}: {len(photos)} photos of {side} px a side; look at what was found: {folder / FOUND}")
    if as_json:
        sizes = {"side": first.opening_cm, "unit": unit, "size": size, "focal_mm": focal_mm or None}
        print_json({"out": str(folder), **sizes, "kept": kept, "photos": photos, "skipped": skipped})


def _failed_picture(folder: Path) -> Path:
    """Return the file, beside the folder to write, of the picture that a failure leaves."""
    from metapp.storage.folders import FAILED

    place = folder if folder.name not in ("", "..") else folder.resolve()
    return place.with_name(f"{place.name}{FAILED}")


def _draw(attempt: Attempt, names: Sequence[Path], reason: str, picture: Path, *, quiet: bool) -> bool:
    """Draw what was found in photographs, and return whether the picture was written: what went wrong matters more."""
    with progress(picture.name, quiet=quiet), contextlib.suppress(OSError, ValueError):
        return attempt.write(names, reason, picture)
    return False


def line_about_views(places: Sequence[Sequence[float]]) -> str:
    """Return the line that photographs show one view and one light, "" if they show several or are one alone.

    Args:
        places: of the cameras, [3] each, in sides of the square.

    >>> line_about_views([(0.0, 0.0, 2.0), (0.0, 0.01, 2.0)]).partition(",")[0]
    'all photos are taken from one place'
    >>> line_about_views([(0.0, 0.0, 2.0), (0.5, 0.0, 2.0)])
    ''
    """
    apart = max((math.dist(place, places[0]) for place in places[1:]), default=math.inf)
    if apart > ONE_PLACE_SIDES:
        return ""
    return (
        f"all photos are taken from one place, within {apart:.2f} sides of the square, expected several views and "
        "lights; maps say no more of the relief than from one photo: move camera and flash by half a side or more."
    )


def _line_about_cut(kept: float) -> str:
    """Return the line about the share of the photographs' common square that is kept, "" where that is all."""
    if not kept:
        return (
            "the square shows surfaces at several heights, and no plane in the middle, expected a sample there; go "
            "closer, so that it fills the middle of each photo."
        )
    cut = f"cut to {100 * kept:.0f} % of the photographs' common square, the part in which they agree with one plane"
    return cut if kept < 1 else ""
