"""Hand-held photographs of a flat material, turned into a folder of rectified ones, with lines about what is wrong.

This is the work of `metapp data rectify`: it finds files, skips what cannot be rectified, and says what is doubtful.
How photographs are rectified is decided in `rectified_photos` and `sample`.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from data_tools.readers.image_files import lens_of
from data_tools.readers.lenses import ExifLens
from data_tools.readers.square_photos import find_images
from metapp.extensions.capture.rectified.found_outlines import FoundOutlines
from metapp.extensions.capture.rectified.marker_options import RectifyOptions
from metapp.extensions.capture.rectified.rectified_photos import CameraSearch, write_rectified_photos
from metapp.extensions.capture.rectified.sample import find_sample, measure_agreement
from metapp.extensions.capture.rectified.sheet import Floats
from metapp.extensions.capture.rectified.sighting import Camera
from metapp.runs.reporter import progress, say
from metapp.storage.folders import FAILED_PICTURE_SUFFIX, FOUND_FOLDER

ONE_VIEW_SIDES = 0.1  # cameras closer to each other than this see the material alike
# The share of the square in which photographs agree, below which a line says so. Of 22 simulated sets without a raised
# sample, 21 agree in 0.94 or more, one, whose photographs are up to 0.7 texels of 192 out of place, in 0.85.
MIN_AGREEMENT_SHARE = 0.8


class RectifiedPhotos(NamedTuple):
    """Photographs that were rectified, in the order of their files.

    Attributes:
        cameras: the cameras of the photographs, the one from nearest to straight above first.
        lights_cm: the places of their flashes, [3] each.
        size: the side of the pictures, in px.
        focal_mm: the focal length, as on 35 mm film, that was found for photographs that do not state it; 0 if all do.
        kept_share: the share of the photographs' common square that is kept.
        agreement: the share of the square in which photographs agree, see :func:`measure_agreement`; 1 with a sheet.
        skipped: a line for each photograph that was left out.
    """

    cameras: Sequence[Camera]
    lights_cm: Sequence[Floats]
    size: int
    focal_mm: float
    kept_share: float
    agreement: float
    skipped: list[str]

    @property
    def registration_basis(self) -> str:
        """The word for what photographs are registered by."""
        return "markers" if self.cameras[0].sighting.shows_sheet else "points"

    @property
    def length_unit(self) -> str:
        """The word for the unit of lengths."""
        return "cm" if self.cameras[0].sighting.shows_sheet else "sides"

    def describe_photos(self) -> list[dict[str, Any]]:
        """Return what --json prints of each photograph."""
        return [
            {
                "file": f"{number:02}.png",
                "source": str(camera.sighting.path),
                self.registration_basis: len(camera.sighting.markers),
                "reference": camera.sighting.is_reference,
                "error_px": camera.error_px,
                "aside_degrees": camera.view_angle_degrees,
                "tilt_degrees": camera.tilt_degrees,
                "camera": camera.place_cm.tolist(),
                "light": light_cm.tolist(),
            }
            for number, (camera, light_cm) in enumerate(zip(self.cameras, self.lights_cm, strict=True))
        ]


def rectify_photos(paths: Sequence[Path], options: RectifyOptions, folder: Path, *, quiet: bool) -> RectifiedPhotos:
    """Rectify photographs of a flat material and write them with the positions of cameras and flashes.

    Pictures of what was found are written into the folder, or beside it where no photograph could be rectified.

    Args:
        paths: the photographs, or folders of them.
        options: the options about photographs and pictures.
        folder: the folder to write to, new or empty.
        quiet: whether warnings alone are shown.

    Raises:
        ValueError: no photograph fits the others, the flash is given in cm without a marker sheet, or OpenCV is not
            installed.
        OSError: a file cannot be written.
    """
    found_files = [find_images(path) for path in paths]
    names = list({file.resolve(): file for files, _ in found_files for file in files}.values())
    if len(names) > options.most:
        say(f"{len(names)} photos: {options.most} of them, spread evenly, are taken; --most {len(names)} takes all")
        names = [names[row] for row in np.linspace(0, len(names) - 1, options.most).round().astype(int)]
    if not options.fov and (line := describe_doubtful_lenses(names)):
        say(f"warning: {line}")
    found_outlines, failed_picture = FoundOutlines(), _failed_picture_path(folder)
    try:
        with progress("photos", len(names), quiet=quiet) as bar:
            search = CameraSearch(
                names,
                math.radians(options.fov),
                options.ruler,
                report_photo=bar.advance,
                report_stage=lambda stage: bar.set_done(0, None, stage),  # how many stages follow is not known
                keep_outlines=found_outlines.keep_outlines,
            )
            cameras, focal_mm, skipped, kept_share = find_sample(search)
    except ValueError as error:
        is_drawn = _draw_found(found_outlines, names, str(error), failed_picture, quiet=quiet)
        raise ValueError(f"{str(error).removesuffix('.')}; see {failed_picture}." if is_drawn else str(error)) from None
    skipped = [*(line for _, lines in found_files for line in lines), *skipped]
    for line in skipped:
        say(f"warning: skipped: {line}")
    flash_cm = options.flash or (0.0, 0.0)
    _say_notes(cameras, flash_cm, kept_share, folder, quiet=quiet)
    lights_cm, first = [camera.offset_place_cm(*flash_cm) for camera in cameras], cameras[0].sighting
    agreement = 1.0 if first.shows_sheet else measure_agreement(cameras)
    if line := describe_agreement(agreement):
        say(f"warning: {folder}: {line}")
    if line := describe_single_view([(camera.place_cm / first.opening_cm).tolist() for camera in cameras]):
        say(f"warning: {folder}: {line}")
    size = min(options.size, int(first.opening_cm * first.px_per_cm()[0]))  # no finer than the one with most detail
    with progress("pictures", len(cameras), quiet=quiet) as bar:
        write_rectified_photos(cameras, lights_cm, size, folder, bar.advance)
    failed_picture.unlink(missing_ok=True)  # the picture of an earlier command
    skipped_names = [name for name in names if name not in [camera.sighting.path for camera in cameras]]
    if skipped_names:
        _draw_found(found_outlines, skipped_names, "skipped:", folder / FOUND_FOLDER / "skipped.png", quiet=quiet)
    return RectifiedPhotos(cameras, lights_cm, size, focal_mm, kept_share, agreement, skipped)


def _say_notes(
    cameras: Sequence[Camera], flash_cm: Sequence[float], kept_share: float, folder: Path, *, quiet: bool
) -> None:
    """Say by what photographs are registered, how much of the square is left, and what is doubtful about the flash.

    Raises:
        ValueError: the flash is beside the lens by some cm, and no photograph shows how long these are.
    """
    has_flash_offset, has_sheet = any(flash_cm), cameras[0].sighting.shows_sheet
    if has_flash_offset and not has_sheet:
        raise ValueError(
            "--flash: cm, but no photo shows the marker sheet, which tells how long they are; leave it out."
        )
    if not has_sheet and not quiet:
        say(f"no markers: {len(cameras)} photos registered by their own features; lengths are in sides of the square")
    if line := _describe_cut(kept_share):
        say(f"{'' if kept_share else 'warning: '}{folder}: {line}")
    if has_flash_offset and len({sighting.height > sighting.width for sighting, *_ in cameras}) > 1:
        say("warning: some photos are upright, some across: --flash is right and up in each as it is shown.")


def _failed_picture_path(folder: Path) -> Path:
    """Return the file, beside the folder to write, of the picture that a failure leaves."""
    named_folder = folder if folder.name not in ("", "..") else folder.resolve()
    return named_folder.with_name(f"{named_folder.name}{FAILED_PICTURE_SUFFIX}")


def _draw_found(
    found_outlines: FoundOutlines, names: Sequence[Path], reason: str, picture: Path, *, quiet: bool
) -> bool:
    """Draw what was found in photographs, and return whether the picture was written.

    A picture that cannot be written is no error: what went wrong before matters more.
    """
    with progress(picture.name, quiet=quiet), contextlib.suppress(OSError, ValueError):
        return found_outlines.write(names, reason, picture)
    return False


def describe_doubtful_lenses(paths: Sequence[Path]) -> str:
    """Return the line that EXIF does not surely tell the field of view of photographs; "" if it does for all of them.

    It is said before the work, which takes minutes, and at whose end too little tilt may show.
    """
    lenses: dict[Path, ExifLens] = {}
    for path in paths:
        with contextlib.suppress(ValueError, OSError):  # reading the photograph says what is wrong
            lenses[path] = lens_of(path)
    unknown = {path: lens for path, lens in lenses.items() if lens.is_part or not lens.focal_mm}
    doubtful = unknown or {path: lens for path, lens in lenses.items() if lens.focal_range > 1}
    if not doubtful:
        return ""
    path, lens = next(iter(doubtful.items()))
    further = f" and {len(doubtful) - 1} more of {len(paths)} photos" if len(doubtful) > 1 else ""
    reason = f" ({lens.note})" if lens.note else ""
    taken = "looked for by how tilted photos differ, in vain from straight above"
    if not unknown:
        taken = f"{lens.focal_mm:.0f} mm is taken"
    return (
        f"{path}{further}: no focal length in EXIF that surely holds{reason}; {taken}: --fov DEGREES states the field."
    )


def describe_single_view(places: Sequence[Sequence[float]]) -> str:
    """Return the line that photographs show one view and one light; "" if they show several or are one alone.

    Args:
        places: the places of the cameras, [3] each, in sides of the square.

    >>> describe_single_view([(0.0, 0.0, 2.0), (0.0, 0.01, 2.0)]).partition(",")[0]
    'all photos are taken from one place'
    >>> describe_single_view([(0.0, 0.0, 2.0), (0.5, 0.0, 2.0)])
    ''
    """
    distance = max((math.dist(place, places[0]) for place in places[1:]), default=math.inf)
    if distance > ONE_VIEW_SIDES:
        return ""
    return (
        f"all photos are taken from one place, within {distance:.2f} sides of the square, expected several views and "
        "lights; maps say no more of the relief than from one photo: move camera and flash by half a side or more."
    )


def describe_agreement(share: float) -> str:
    """Return the line that photographs agree in a small share of the square; "" if they agree in most of it.

    >>> describe_agreement(0.9)
    ''
    """
    if share >= MIN_AGREEMENT_SHARE:
        return ""
    return (
        f"photos agree in {100 * share:.0f} % of the square, expected {100 * MIN_AGREEMENT_SHARE:.0f} % or more; maps "
        "may be wrong where details are few, another surface is seen, or photos are out of place: print a frame of "
        "markers."
    )


def _describe_cut(kept_share: float) -> str:
    """Return the line about the share of the photographs' common square that is kept; "" where that is all of it."""
    if not kept_share:
        return (
            "the square shows surfaces at several heights, and no plane in the middle, expected a sample there; go "
            "closer, so that it fills the middle of each photo."
        )
    percent = f"{100 * kept_share:.0f} %"
    cut = f"cut to {percent} of the photographs' common square, the part in which they agree with one plane"
    return cut if kept_share < 1 else ""
