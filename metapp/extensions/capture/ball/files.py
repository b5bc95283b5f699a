"""Files of a captured ball: what was found, a map for people, a data set for fits."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from data_tools.readers.image_files import read_pixels
from data_tools.readers.photos import linear_light
from metapp.appearance.colour import linear_to_srgb
from metapp.extensions.capture.ball.capture import Capture
from metapp.extensions.capture.ball.shots import Shot
from metapp.storage.images import write_exr, write_png
from metapp.storage.shards import ShardWriter

FOUND = "found"  # folder of pictures that show what was found
UNITS = {
    "photos": "the ball as a camera far away sees it, display values, uint8 0..255 [1, 3, 64, 64]; black outside",
    "seen": "lat-long radiance that the ball mirrors, linear Rec.709 [3, H, 2 H], rows from the top (+y), the middle "
    "column looks to +z, to the camera; 1 is white in `photos`; 0 where nothing is seen",
    "certain": "[2, H, 2 H] in [0, 1]: how far a texel is seen unclipped; how far it is seen but white in all photos, "
    "so that `seen` is a lower bound",
}

_SHOWN_PX = 1200  # the longer side of pictures that show what was found


def write_capture(
    name: str, paths: Sequence[Path], captured: Capture, folder: Path, *, overwrite: bool = False
) -> None:
    """Write a data set of one task, its map NAME.exr and found/*.png.

    Args:
        name: of the task.
        paths: the photographs.
        captured: what they show.
        folder: made if missing.
        overwrite: whether a data set that is there is replaced.

    Raises:
        ValueError: the folder holds another application's data set.
        OSError: a file cannot be written.
    """
    notes = {
        "made_by": "metapp data ball",
        "photos": [path.name for path in paths],
        "exposures": [float(value) for value in captured.exposures],
        "power": captured.power,
        "files": [FOUND, f"{name}.exr"],
    }
    with ShardWriter(folder, "illumination", UNITS, notes, overwrite=overwrite) as writer:
        writer.add(captured.task(name), "test", paths[captured.chosen])
        (folder / FOUND).mkdir(exist_ok=True)
        for path, shot in zip(paths, captured.shots, strict=True):
            write_png(shown(path, shot), {"encoding": "sRGB"}, folder / FOUND / f"{path.stem}.png")
        write_exr(torch.cat([captured.seen, captured.certain[:1]]).permute(1, 2, 0), folder / f"{name}.exr")


def shown(path: Path, shot: Shot) -> Tensor:
    """A photograph with the contour that was found, [H, W, 3] display values in [0, 1]."""
    from PIL import Image, ImageDraw

    pixels = read_pixels(path)
    step = max(1, -(-max(pixels.values.shape[:2]) // _SHOWN_PX))
    linear = linear_light(pixels._replace(values=pixels.values[::step, ::step]), slice(None))[..., :3]
    display = (linear_to_srgb(torch.from_numpy(np.ascontiguousarray(linear))).numpy() * 255).round().astype(np.uint8)
    image = Image.fromarray(display)
    angles = np.linspace(0, 2 * np.pi, 361)
    contour = shot.ball.to_px(np.stack([np.cos(angles), np.sin(angles)])) / step
    ImageDraw.Draw(image).line([(float(x), float(y)) for x, y in contour.T], fill="#00ff00", width=1)
    return torch.from_numpy(np.asarray(image, dtype=np.float32) / np.float32(255))
