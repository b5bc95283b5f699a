"""The light around a mirror ball, written as a data set, a map and pictures of the balls that were found.

How the light is recovered is not known here; see :mod:`metapp.extensions.capture.ball.capture`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from data_tools.readers.image_files import read_pixels
from metapp.appearance.latlong import level_maps
from metapp.extensions.capture.ball.ball_options import BallOptions
from metapp.extensions.capture.ball.capture import CapturedLight, capture_light
from metapp.extensions.capture.hand_photos import write_outlines
from metapp.learning.task import Task
from metapp.runs.reporter import progress
from metapp.storage.folders import FOUND_FOLDER
from metapp.storage.image_writers import write_exr
from metapp.storage.shards import write_data_set

LIGHT_UNITS = {
    "photos": "the ball as a camera far away sees it, display values, uint8 0..255 [1, 3, 64, 64]; black outside",
    "seen": "lat-long radiance that the ball mirrors, linear Rec.709 [3, H, 2 H], rows from the top (+y), the middle "
    "column looks to +z, to the camera; 1 is white in `photos`; 0 where nothing is seen",
    "certain": "[2, H, 2 H] in [0, 1]: how far a texel is seen unclipped; how far it is seen but white in all photos, "
    "so that `seen` is a lower bound",
}


def write_light(
    paths: Sequence[Path], options: BallOptions, folder: Path, *, overwrite: bool, quiet: bool
) -> CapturedLight:
    """Read the light around a ball from photographs of it, and write all that was found.

    Args:
        paths: the photographs of one ball, of different exposures.
        options: the options about photographs and map.
        folder: the folder of the data set; its name is the name of the task and of the map.
        overwrite: whether a data set that is there is replaced.
        quiet: whether no progress is shown.

    Returns:
        The light, and where the balls are in the photographs.

    Raises:
        ValueError: a photograph cannot be read or shows no ball, or shutter times have another number or form.
        OSError: a file cannot be written.
    """
    with progress("photos", len(paths), quiet=quiet) as bar:
        fov_rad = math.radians(options.fov)
        captured = capture_light(
            paths, options.shutter, options.rows, fov_rad, options.ball, bar.advance, options.layer
        )
        bar.set_label("writing the map and pictures of what was found")
        _write_light_files(folder.resolve().name, paths, captured, folder, options, overwrite=overwrite)
    return captured


def _write_light_files(
    name: str, paths: Sequence[Path], captured: CapturedLight, folder: Path, options: BallOptions, *, overwrite: bool
) -> None:
    """Write a data set of one task, its map NAME.exr, and pictures of the balls in found/."""
    notes = {
        "made_by": "metapp data ball",
        "photos": [path.name for path in paths],
        "exposures": captured.exposures.tolist(),
        "power": captured.power,
        "files": [FOUND_FOLDER, f"{name}.exr"],
    }
    angles = np.linspace(0, 2 * np.pi, 361)

    def make_task() -> Iterator[tuple[Task, str, Path]]:
        yield Task(name, captured.data), "test", paths[captured.reference_index]
        for path, ball in zip(paths, captured.balls, strict=True):
            contour = ball.to_px(np.stack([np.cos(angles), np.sin(angles)])).T
            write_outlines(
                read_pixels(path, options.layer), [(contour, "lime")], folder / FOUND_FOLDER / f"{path.stem}.png"
            )
        write_exr(_level_light(captured.data, options.pitch).permute(1, 2, 0), folder / f"{name}.exr")

    write_data_set(folder, "illumination", LIGHT_UNITS, make_task(), notes, overwrite=overwrite)


def _level_light(data: Mapping[str, Tensor], pitch_degrees: float) -> Tensor:
    """Return the light of a ball and how far it is seen unclipped, [4, H, W], of a level horizon.

    Texels that the ball does not show have radiance 0, which is not averaged with what is seen beside them.
    """
    seen, certain = data["seen"], data["certain"]
    if not pitch_degrees:
        return torch.cat([seen, certain[:1]])
    weight = certain.sum(0, keepdim=True)
    planes = level_maps(torch.cat([seen * weight, weight, certain[:1]]), math.radians(pitch_degrees))
    return torch.cat([planes[:3] / planes[3:4].clamp_min(1e-6), planes[4:]])
