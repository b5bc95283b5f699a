"""The commands of `metapp data` for photographs of a flat material, with a printed marker sheet or without."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.arguments import JsonFlag, Out, Overwrite, Quiet, check_new_file, expand_options
from metapp.cli.console import print_json
from metapp.extensions.capture.markers.marker_options import RectifyOptions, SheetOptions
from metapp.runs.reporter import say
from metapp.storage.files import add_suffix
from metapp.storage.folders import DIAGNOSTIC_FOLDER, FAILED_PICTURE_SUFFIX, check_files_of_user


@expand_options(SheetOptions)
def markers_command(
    options: SheetOptions,
    path: Annotated[Path, typer.Argument(metavar="OUT.pdf", help="File to write.")],
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: JsonFlag = False,
) -> None:
    """Write a marker sheet to print: a frame of markers round an opening, which is laid on a flat material.

    `metapp data rectify` finds the markers in photographs of it. Needs OpenCV, which metapp's extra
    `capture` installs.

    Example:
      metapp data markers sheet.pdf
    """
    path, opening = add_suffix(path, ".pdf"), options.opening
    check_new_file(path, overwrite)
    from metapp.extensions.capture.markers.sheet_page import write_marker_sheet

    write_marker_sheet(path, opening, options.page)
    if not quiet:
        say(f"{path}: a sheet with an opening of {opening} x {opening} cm; print it at 100 % and measure its ruler")
    if as_json:
        print_json({"path": str(path), "opening_cm": opening, "page": options.page})


@expand_options(RectifyOptions)
def rectify_command(
    options: RectifyOptions,
    paths: Annotated[list[Path], typer.Argument(metavar="PHOTO...", help="Photographs, or folders of them.")],
    folder: Out,
    quiet: Quiet = False,
    as_json: JsonFlag = False,
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
    if folder.is_dir() and any(folder.iterdir()):
        raise ValueError(f"{folder}: holds files, expected a new or empty folder to write to; choose another one.")
    photos_alone = [
        path for path in paths if not path.name.endswith(FAILED_PICTURE_SUFFIX)
    ]  # which a shell's *.png names, too
    for path in photos_alone or paths:
        check_files_of_user(path, "photographs of a flat material")
    from metapp.extensions.capture.markers.rectification import rectify_photos

    rectified = rectify_photos(photos_alone, options, folder, quiet=quiet)
    photos, size, focal_mm = rectified.photos(), rectified.size, rectified.focal_mm
    first, marks, unit = rectified.cameras[0].sighting, rectified.marks, rectified.unit
    if not quiet:
        for photo in photos:
            off = "the reference" if photo["reference"] else f"error {photo['error_px']:.2f} px"
            found = f"{Path(photo['source']).name}, {photo[marks]} {marks}, {off}"
            away = f"camera {math.hypot(*photo['camera']):.1f} {unit} away, {photo['aside_degrees']:.0f} degrees aside"
            say(f"{photo['file']}: {found}, {away}, tilted by {photo['tilt_degrees']:.0f}")
        if focal_mm:
            say(f"focal length: {focal_mm:.1f} mm as of 35 mm film, found by the {marks}, as EXIF has none")
        side = f"{first.opening_cm:g} cm, {size}" if first.sheet else f"{size}"
        say(f"{folder}: {len(photos)} photos of {side} px a side; look at what was found: {folder / DIAGNOSTIC_FOLDER}")
    if as_json:
        sizes = {"side": first.opening_cm, "unit": unit, "size": size, "focal_mm": focal_mm or None}
        print_json(
            {"out": str(folder), **sizes, "kept": rectified.kept, "photos": photos, "skipped": rectified.skipped}
        )
