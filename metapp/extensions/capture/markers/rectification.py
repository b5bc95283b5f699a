"""Hand-held photographs of a flat material, turned into a folder of rectified ones, with lines about what is wrong."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from data_tools.readers.square_photos import find_images
from metapp.extensions.capture.markers.found_outlines import FoundOutlines
from metapp.extensions.capture.markers.marker_options import RectifyOptions
from metapp.extensions.capture.markers.rectified_photos import write_rectified_photos
from metapp.extensions.capture.markers.sample import find_sample
from metapp.extensions.capture.markers.sheet import Floats
from metapp.extensions.capture.markers.sighting import Camera
from metapp.runs.reporter import progress, say
from metapp.storage.folders import DIAGNOSTIC_FOLDER, FAILED_PICTURE_SUFFIX

ONE_VIEW_SIDES = 0.1  # sides of the square, within which cameras see the same


class RectifiedPhotos(NamedTuple):
    """Photographs that were rectified, in the order of their files.

    Attributes:
        cameras: of the photographs, the one from nearest to straight above first.
        lights_cm: places of their flashes.
        size: side of the pictures, px.
        focal_mm: as of 35 mm film, of photographs that do not state it; 0 if all do.
        kept: share of the photographs' common square that is kept.
        skipped: a line for each photograph that was left out.
    """

    cameras: Sequence[Camera]
    lights_cm: Sequence[Floats]
    size: int
    focal_mm: float
    kept: float
    skipped: list[str]

    @property
    def marks(self) -> str:
        """The name of what photographs are registered by."""
        return "markers" if self.cameras[0].sighting.sheet else "points"

    @property
    def unit(self) -> str:
        """The name of the unit of lengths."""
        return "cm" if self.cameras[0].sighting.sheet else "sides"

    def photos(self) -> list[dict[str, Any]]:
        """Return what --json prints of each photograph."""
        return [
            {
                "file": f"{number:02}.png",
                "source": str(camera.sighting.path),
                self.marks: len(camera.sighting.markers),
                "reference": camera.sighting.reference,
                "error_px": camera.error_px,
                "aside_degrees": camera.aside_degrees,
                "tilt_degrees": camera.tilt_degrees,
                "camera": camera.place_cm.tolist(),
                "light": light_cm.tolist(),
            }
            for number, (camera, light_cm) in enumerate(zip(self.cameras, self.lights_cm, strict=True))
        ]


def rectify_photos(paths: Sequence[Path], options: RectifyOptions, folder: Path, *, quiet: bool) -> RectifiedPhotos:
    """Rectify photographs of a flat material and write them with the positions of cameras and flashes.

    Pictures of what was found lie in the folder, and beside it where no photograph could be rectified.

    Args:
        paths: photographs, or folders of them.
        options: about photographs and pictures.
        folder: the folder to write to, new or empty.
        quiet: no progress, warnings alone.

    Raises:
        ValueError: no photograph fits the others; a flash in cm without a marker sheet; OpenCV is not installed.
        OSError: a file cannot be written.
    """
    in_paths = [find_images(path) for path in paths]
    names = list({file.resolve(): file for files, _ in in_paths for file in files}.values())
    attempt, failed = FoundOutlines(), _failed_picture(folder)
    try:
        with progress("photos", len(names), quiet=quiet) as bar:
            fov_rad, done, begin = math.radians(options.fov), bar.advance, bar.set_label
            cameras, focal_mm, skipped, kept = find_sample(names, fov_rad, options.ruler, done, begin, attempt.show)
    except ValueError as error:
        drawn = _draw(attempt, names, str(error), failed, quiet=quiet)
        raise ValueError(f"{str(error).removesuffix('.')}; see {failed}." if drawn else str(error)) from None
    skipped = [*(line for _, lines in in_paths for line in lines), *skipped]
    for line in skipped:
        say(f"warning: skipped: {line}")
    flash_cm = options.flash or (0.0, 0.0)
    _say_what_to_know(cameras, flash_cm, kept, folder, quiet=quiet)
    lights_cm, first = [camera.beside_cm(*flash_cm) for camera in cameras], cameras[0].sighting
    if line := describe_single_view([(camera.place_cm / first.opening_cm).tolist() for camera in cameras]):
        say(f"warning: {folder}: {line}")
    size = min(options.size, int(first.opening_cm * first.scales()[0]))  # no finer than the one with most detail
    with progress("pictures", len(cameras), quiet=quiet) as bar:
        write_rectified_photos(cameras, lights_cm, size, folder, bar.advance)
    failed.unlink(missing_ok=True)  # of an earlier command
    left = [name for name in names if name not in [camera.sighting.path for camera in cameras]]
    if left:
        _draw(attempt, left, "skipped:", folder / DIAGNOSTIC_FOLDER / "skipped.png", quiet=quiet)
    return RectifiedPhotos(cameras, lights_cm, size, focal_mm, kept, skipped)


def _say_what_to_know(
    cameras: Sequence[Camera], flash_cm: Sequence[float], kept: float, folder: Path, *, quiet: bool
) -> None:
    """Say by what photographs are registered, how much of the square is left, and what is doubtful about the flash.

    Raises:
        ValueError: the flash is beside the lens by some cm, and no photograph shows how long these are.
    """
    is_aside, has_sheet = any(flash_cm), cameras[0].sighting.sheet
    if is_aside and not has_sheet:
        raise ValueError(
            "--flash: cm, but no photo shows the marker sheet, which tells how long they are; leave it out."
        )
    if not has_sheet and not quiet:
        say(f"no markers: {len(cameras)} photos registered by their own features; lengths are in sides of the square")
    if line := _line_about_cut(kept):
        say(f"{'' if kept else 'warning: '}{folder}: {line}")
    if is_aside and len({sighting.height > sighting.width for sighting, *_ in cameras}) > 1:
        say("warning: some photos are upright, some across: --flash is right and up in each as it is shown.")


def _failed_picture(folder: Path) -> Path:
    """Return the file, beside the folder to write, of the picture that a failure leaves."""
    place = folder if folder.name not in ("", "..") else folder.resolve()
    return place.with_name(f"{place.name}{FAILED_PICTURE_SUFFIX}")


def _draw(attempt: FoundOutlines, names: Sequence[Path], reason: str, picture: Path, *, quiet: bool) -> bool:
    """Draw what was found in photographs, and return whether the picture was written: what went wrong matters more."""
    with progress(picture.name, quiet=quiet), contextlib.suppress(OSError, ValueError):
        return attempt.write(names, reason, picture)
    return False


def describe_single_view(places: Sequence[Sequence[float]]) -> str:
    """Return the line that photographs show one view and one light, "" if they show several or are one alone.

    Args:
        places: of the cameras, [3] each, in sides of the square.

    >>> line_about_views([(0.0, 0.0, 2.0), (0.0, 0.01, 2.0)]).partition(",")[0]
    'all photos are taken from one place'
    >>> line_about_views([(0.0, 0.0, 2.0), (0.5, 0.0, 2.0)])
    ''
    """
    apart = max((math.dist(place, places[0]) for place in places[1:]), default=math.inf)
    if apart > ONE_VIEW_SIDES:
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
