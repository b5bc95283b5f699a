"""Photographs of glossy balls, turned into a text of light directions, with lines about what is left out.

This is the work of `metapp data lights`: it finds files and names, and says what is doubtful. How directions are
measured is decided in :mod:`metapp.extensions.capture.lights.lit_photos`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from data_tools.readers.square_photos import find_images
from metapp.extensions.capture.lights.lamps import MAX_UNKNOWN_LEAN_DEGREES, unknown_lean_degrees
from metapp.extensions.capture.lights.light_text import write_lights
from metapp.extensions.capture.lights.lights_options import LightsOptions
from metapp.extensions.capture.lights.lit_photos import MIN_PHOTOS, MeasuredLights, measure_lights
from metapp.runs.reporter import progress, say


def find_lights(paths: Sequence[Path], options: LightsOptions, path: Path, *, quiet: bool) -> dict[str, Any]:
    """Find the light's direction in photographs, write them, and say which are left out.

    Args:
        paths: the photographs, or folders of them.
        options: the options about photographs and text.
        path: the text of directions.
        quiet: whether warnings alone are shown.

    Returns:
        What --json prints: balls, photographs with their directions, what is left out and why, the lamp's distance.

    Raises:
        ValueError: photographs cannot be read, no ball is found, or hardly a photograph tells a direction.
        OSError: a file cannot be written.
    """
    photos = _find_photos(paths)
    named = _find_photos([options.names]) if options.names else photos
    if len(named) != len(photos):
        found = f"{options.names}: {len(named)} photo{'s' * (len(named) != 1)}"
        raise ValueError(f"{found}, expected {len(photos)}, as many as show the ball; leave the same ones out.")
    names = [photo.name for photo in named]
    if repeated := next((name for name in names if names.count(name) > 1), ""):
        raise ValueError(
            f"{repeated}: the name of several photos, expected one in each; rename or leave out the others."
        )
    with progress("photos", 2 * len(photos), quiet=quiet) as bar:
        lights = measure_lights(photos, options.ball, math.radians(options.fov), options.layer, bar.advance)
    lean_degrees = unknown_lean_degrees([lit_ball.ball for lit_ball in lights.balls], lights.shape)
    if lean_degrees > MAX_UNKNOWN_LEAN_DEGREES:
        lens = "field of view unknown, the camera is taken to be far away; for a 50 mm lens"
        found = f"directions are {lean_degrees:.0f} degrees off, expected {MAX_UNKNOWN_LEAN_DEGREES:.0f} or less"
        say(f"warning: {paths[0]}: {lens} {found}: state --fov, or place the ball nearer to the middle")
    for number, fault in lights.faults.items():
        say(f"warning: left out: {photos[number]}: {fault}")
    if len(photos) - len(lights.faults) < MIN_PHOTOS:
        found = f"{len(photos) - len(lights.faults)} of {len(photos)} photos show where the light is"
        raise ValueError(
            f"{paths[0]}: {found}, expected {MIN_PHOTOS} or more; say where the ball is with --ball X,Y,RADIUS."
        )
    write_lights(lights, names, path, shows_balls=not options.names)
    _say_where_to_put(path, named)
    return _describe(lights, names)


def _find_photos(paths: Sequence[Path]) -> list[Path]:
    """Return photographs and those in folders, each once, and say which files of folders are skipped."""
    found_files = [find_images(path) for path in paths]
    for line in (line for _, lines in found_files for line in lines):
        say(f"warning: skipped: {line}")
    return list({file.resolve(): file for files, _ in found_files for file in files}.values())


def _say_where_to_put(path: Path, photos: Sequence[Path]) -> None:
    """Say that a text of directions is read beside its photographs, if it is elsewhere."""
    folder = photos[0].resolve().parent
    if any(photo.resolve().parent != path.resolve().parent for photo in photos):
        say(f"warning: {path}: not beside its photos, where fits look for it; move it to {folder}")


def _describe(lights: MeasuredLights, names: Sequence[str]) -> dict[str, Any]:
    """Return what --json prints of the directions of photographs that are written under these names."""
    directions, is_near = lights.lamps.directions.tolist(), math.isfinite(lights.lamps.distance)
    return {
        "balls": [
            {
                "x": lit_ball.ball.x,
                "y": lit_ball.ball.y,
                "radius": lit_ball.ball.radius,
                "photos": sum(not highlight.fault for highlight in lit_ball.highlights),
            }
            for lit_ball in lights.balls
        ],
        "distance_widths": lights.lamps.distance if is_near else None,
        "parallax_degrees": lights.lamps.parallax_degrees,
        "noise_degrees": lights.lamps.noise_degrees,
        "photos": [
            {"source": str(photo), "name": name, "direction": directions[number]}
            for number, (photo, name) in enumerate(zip(lights.paths, names, strict=True))
            if number not in lights.faults
        ],
        "left_out": [
            {"source": str(lights.paths[number]), "fault": fault} for number, fault in sorted(lights.faults.items())
        ],
    }
