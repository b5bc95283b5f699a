"""Photographs by a camera that stands still under a lamp that moves, with a text of the lamp's directions (RTI).

Reflectance transformation imaging (Malzbender et al. 2001) is how museums photograph relief: the camera looks straight
down, the light comes from a dome or a lamp that is carried around, and programs such as RTIBuilder and Relight write a
file `.lp`: the number of photographs, then for each its name and the direction to the light, x right, y up, z towards
the camera.
"""

from __future__ import annotations

import math
from pathlib import Path, PureWindowsPath

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from metapp.appearance.flash import texel_positions
from metapp.storage.files import read_text
from metapp.storage.folders import list_folder

FAR_HALF_SIDES = 20.0  # distance of the camera
NEAREST_HALF_SIDES, FARTHEST_HALF_SIDES = 2.0, 50.0  # of lights
LIGHT_DIRECTIONS_SUFFIX = ".lp"  # of a text beside photographs by a camera that stands still
COMPARED_CELLS = 16  # a side of the photographs, by which the distance of the lights is found
MIN_SINE = math.sin(math.radians(10))  # of the angle of a light with the material: lower ones leave it in shadow


def find_light_file(folder: Path) -> Path | None:
    """Return the text of light directions in a folder; None if it has none.

    Raises:
        ValueError: there are several.
    """
    names = sorted(
        entry.name
        for entry in list_folder(str(folder))
        if entry.name.lower().endswith(LIGHT_DIRECTIONS_SUFFIX) and not entry.name.startswith(".")
    )
    if len(names) > 1:
        raise ValueError(f"{folder}: {', '.join(names[:3])}, expected one text of light directions; remove the others.")
    return folder / names[0] if names else None


def read_lights(path: Path) -> tuple[list[Path], Tensor]:
    """Read a text of light directions, which does not tell how far the lights are.

    Photographs are looked for by their names beside the text, whatever folder the text states, since such texts are
    moved with their photographs. Lights that graze the material, by less than 10 degrees, are left out.

    Args:
        path: the text: the number of photographs, then a line "name x y z" for each.

    Returns:
        The photographs, and positions of camera and light of each, [N, 2, 3], in half sides of the patch: all are
        FAR_HALF_SIDES away; :func:`find_light_distance` tells how far the lights are.

    Raises:
        ValueError: the text cannot be read, a line is malformed, or a photograph is missing.
    """
    try:
        numbered_lines = [(number, line) for number, line in enumerate(read_text(path).splitlines(), 1) if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: cannot be read as text, expected a line for each photo; write it again.") from error
    expected = "expected the number of photos, then 'name x y z' for each; correct it."
    if not numbered_lines:
        raise ValueError(f"{path}: no line, {expected}")
    (number, count_line), *photo_lines = numbered_lines
    # compared as texts, since int() refuses some digits, and numbers of thousands of digits
    if count_line.strip().lstrip("0") != str(len(photo_lines)):
        found = f"line {number} is {count_line.strip()[:20]!r} above {len(photo_lines)} lines"
        raise ValueError(f"{path}: {found}, {expected}")
    photos, directions = zip(*(_read_line(path, *photo_line) for photo_line in photo_lines), strict=True)
    towards = torch.nn.functional.normalize(torch.tensor(directions, dtype=torch.float64), dim=1).float()
    is_above = (towards[:, 2] > MIN_SINE).tolist()
    places = FAR_HALF_SIDES * torch.stack([torch.tensor([0.0, 0.0, 1.0]).expand_as(towards), towards], 1)
    return [photo for photo, above in zip(photos, is_above, strict=True) if above], places[is_above]


def find_light_distance(photos: Tensor, places: Tensor) -> float:
    """Find how far lights of one distance are, by how photographs darken away from their lights.

    The irradiance of a point light at the distance r, in the direction l from the middle, falls by the factor
    exp(-3 l . x / r) towards a place -x nearby. The colours of the material cancel in the ratio of photographs.

    Args:
        photos: linear photographs [N, 3, S, S] by a camera that stands still.
        places: positions of camera and light, [N, 2, 3], of which the directions count.

    Returns:
        The distance in half sides of the photographs, NEAREST_HALF_SIDES to FARTHEST_HALF_SIDES.
    """
    logs = adaptive_avg_pool2d((photos.mean(1, keepdim=True) + 0.01).log(), COMPARED_CELLS)[:, 0]
    ratios = logs - logs.mean(0)
    across = texel_positions(COMPARED_CELLS, COMPARED_CELLS).to(photos)
    gradients = (ratios[:, None] * across).mean((2, 3)) / across.square().mean((1, 2))  # [N, 2], of a half side
    towards = torch.nn.functional.normalize(places[:, 1], dim=1)[:, :2]
    towards = towards - towards.mean(0)
    inverse = float((gradients * towards).sum() / (3 * towards.square().sum()).clamp_min(1e-6))
    return 1 / min(max(inverse, 1 / FARTHEST_HALF_SIDES), 1 / NEAREST_HALF_SIDES)


def _read_line(path: Path, number: int, line: str) -> tuple[Path, list[float]]:
    """Return the photograph of a line "name x y z", which has this number, and the direction to its light."""
    name, *words = line.strip().rsplit(None, 3)
    try:
        direction = [float(word) for word in words]
    except ValueError:
        direction = []
    if len(direction) != 3 or not 1e-3 < math.hypot(*direction) < 1e6:
        found = f"line {number} is {line.strip()[:60]!r}"
        raise ValueError(f"{path}: {found}, expected a name and a direction x y z; correct it.")
    photo = path.parent / PureWindowsPath(name.strip('"')).name  # either kind of slash
    if not photo.is_file():
        found = f"line {number} names {photo.name[:60]!r}, no such file beside it"
        raise ValueError(f"{path}: {found}, expected the photo; copy it there.")
    return photo, direction
