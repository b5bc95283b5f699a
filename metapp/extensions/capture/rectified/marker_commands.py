"""The commands of `metapp data` for photographs of a flat material, with a printed marker sheet or without.

Only arguments and messages are made here; `rectification` and `sheet_page`, which are imported when a command runs, do
the work.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.arguments import JsonFlag, Out, Overwrite, Quiet, check_new_file, expand_options
from metapp.cli.console import print_json
from metapp.extensions.capture.rectified.marker_options import RectifyOptions, SheetOptions
from metapp.runs.inputs.refusals import check_files_of_user
from metapp.runs.reporter import say
from metapp.storage.files import add_suffix
from metapp.storage.folders import FAILED_PICTURE_SUFFIX, FOUND_FOLDER


@expand_options(SheetOptions)
def markers_command(
    options: SheetOptions,
    path: Annotated[Path, typer.Argument(metavar="OUT.pdf", help="File to write.")],
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: JsonFlag = False,
) -> None:
    """Write a marker sheet to print: a frame of markers round an opening, which is laid on a flat material.

    `metapp data rectify` finds the markers in photographs of the material. Needs OpenCV, which metapp's extra
    `capture` installs.

    Example:
      metapp data markers sheet.pdf
    """
    path, opening = add_suffix(path, ".pdf"), options.opening
    check_new_file(path, overwrite)
    from metapp.extensions.capture.rectified.sheet_page import write_marker_sheet

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

    In photos that show a marker sheet, the sheet's opening is rectified. Where no photo shows a marker, photos are
    registered by the material's own features: aim all at one place, one from about straight above, the others up to 30
    degrees aside. The straightest photo is the reference; the square is the largest that all photos show, and its side
    is the unit of lengths. If a table around the sample is seen, which lies lower, the square stays on the sample.
    Writes square pictures 00.png, 01.png, ..., the straightest first, camera_pos.txt, light_pos.txt and image_size.txt:
    a folder for `metapp meta svbrdf_nonstationary DIR`. Pictures in its folder found/ show the markers or points found.
    Photos that do not fit are skipped, each with a line, and shown by found/skipped.png; if none is left, the picture
    DIR.failed.png beside the folder shows what was found in them. Needs OpenCV: metapp's extra `capture` installs it.

    Examples:
      metapp data rectify photos/ --out leaf
      metapp data rectify IMG_1.jpg IMG_2.jpg IMG_3.jpg --flash 1.2,0 --ruler 9.7 --out leaf
    """
    if folder.is_dir() and any(folder.iterdir()):
        raise ValueError(f"{folder}: holds files, expected a new or empty folder to write to; choose another one.")
    # a shell's *.png also names the picture that an earlier failure left
    photos_alone = [path for path in paths if not path.name.endswith(FAILED_PICTURE_SUFFIX)]
    for path in photos_alone or paths:
        check_files_of_user(path, "photographs of a flat material")
    from metapp.extensions.capture.rectified.rectification import rectify_photos

    rectified = rectify_photos(photos_alone, options, folder, quiet=quiet)
    photos, size, focal_mm = rectified.describe_photos(), rectified.size, rectified.focal_mm
    first, basis, unit = rectified.cameras[0].sighting, rectified.registration_basis, rectified.length_unit
    if not quiet:
        for photo in photos:
            error_text = "the reference" if photo["reference"] else f"error {photo['error_px']:.2f} px"
            found_text = f"{Path(photo['source']).name}, {photo[basis]} {basis}, {error_text}"
            camera_text = (
                f"camera {math.hypot(*photo['camera']):.1f} {unit} away, {photo['aside_degrees']:.0f} degrees aside"
            )
            say(f"{photo['file']}: {found_text}, {camera_text}, tilted by {photo['tilt_degrees']:.0f}")
        if focal_mm:
            say(f"focal length: {focal_mm:.1f} mm on 35 mm film, found by the {basis}, as EXIF has none that holds")
        side = f"{first.opening_cm:g} cm, {size}" if first.shows_sheet else f"{size}"
        say(f"{folder}: {len(photos)} photos of {side} px a side; look at what was found: {folder / FOUND_FOLDER}")
    if as_json:
        size_entries = {"side": first.opening_cm, "unit": unit, "size": size, "focal_mm": focal_mm or None}
        print_json(
            {
                "out": str(folder),
                **size_entries,
                "kept": rectified.kept_share,
                "agreement": rectified.agreement,
                "photos": photos,
                "skipped": rectified.skipped,
            }
        )
