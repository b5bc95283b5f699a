"""Environment maps and photographs of balls in memory; as files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from PIL.Image import Image

from data_tools.readers import latlong
from data_tools.readers.picture_objects import EXPECTED, is_picture, planes_of, rows_of, write_picture
from metapp.appearance.latlong import directions
from metapp.storage.images import write_exr

ROWS = 512  # of a map that a function is evaluated for


def to_file(source: object, name: str, folder: Path, observe: str) -> Path:
    """Write a map as EXR, a photograph as PNG.

    Args:
        source: linear Rec.709 radiance, floating point, [H, 2 H, 3] or gray [H, 2 H], lat-long, rows from the top (+y),
            the middle looks to +z; or f(directions) -> radiance [N, 3] or gray [N] of unit vectors [N, 3], float32
            arrays, +y up, +z from the ball to the camera; or the photograph of a ball, a picture as of
            `picture_objects`.
        name: of the file.
        folder: where to.
        observe: what fits see: "photo" takes floating-point values for a photograph where they are not twice as wide as
            high.

    Raises:
        ValueError: none of these; values of another shape or out of range.
    """
    if callable(source):
        places = directions(ROWS, 2 * ROWS).reshape(3, -1).T.contiguous().numpy()
        source = rows_of(name, source(places), len(places)).reshape(ROWS, 2 * ROWS, -1).astype(np.float32)
    elif not is_picture(source):
        raise ValueError(f"{name}: {type(source).__name__}, expected {EXPECTED} or a function f(directions).")
    if isinstance(source, Image):
        return write_picture(name, source, folder)
    values = planes_of(name, source)
    is_map = values.dtype.kind == "f" and latlong.is_latlong(*values.shape[:2])
    if values.dtype.kind != "f" or (observe == "photo" and not is_map):
        return write_picture(name, values, folder)
    if not is_map:
        raise ValueError(
            f"{name}: an array {list(values.shape)}, expected linear radiance [H, 2 H, 3]; the photo of a ball is for "
            "fits with --observe photo."
        )
    path = folder / f"{name}.exr"
    with np.errstate(over="ignore"):  # what is infinite is refused as of files
        write_exr(torch.from_numpy(values.astype(np.float32)), path, half=False)
    return path
