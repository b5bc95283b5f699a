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

from metapp.storage.files import read_text
from metapp.storage.folders import LIGHT_DIRECTIONS_SUFFIX, list_folder

FAR_HALF_SIDES = 20.0  # distance of camera and light: nearly as of parallel light
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
    """Read a text of light directions.

    Photographs are looked for by their names beside the text, whatever folder the text states, since such texts are
    moved with their photographs. Lights that graze the material, by less than 10 degrees, are left out.

    Args:
        path: the text: the number of photographs, then a line "name x y z" for each.

    Returns:
        The photographs, and the positions of camera and light of each, [N, 2, 3], in half sides of the patch.

    Raises:
        ValueError: the text cannot be read, a line is malformed, or a photograph is missing.
    """
    try:
        lines = [line for line in read_text(path).splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: cannot be read as text, expected a line for each photo; write it again.") from error
    if not lines or not lines[0].strip().isdigit() or int(lines[0]) != len(lines) - 1:
        found = f"{lines[0].strip()[:20]!r} above {len(lines) - 1} lines" if lines else "no line"
        raise ValueError(f"{path}: {found}, expected the number of photos, then 'name x y z' for each; correct it.")
    photos, directions = zip(*(_read_line(path, line) for line in lines[1:]), strict=True)
    towards = torch.nn.functional.normalize(torch.tensor(directions, dtype=torch.float64), dim=1).float()
    is_above = (towards[:, 2] > MIN_SINE).tolist()
    light = FAR_HALF_SIDES * towards
    places = torch.stack([torch.tensor([0.0, 0.0, FAR_HALF_SIDES]).expand_as(light), light], 1)
    return [photo for photo, above in zip(photos, is_above, strict=True) if above], places[is_above]


def _read_line(path: Path, line: str) -> tuple[Path, list[float]]:
    """Return the photograph of a line "name x y z", and the direction to its light."""
    name, *words = line.strip().rsplit(None, 3)
    try:
        direction = [float(word) for word in words]
    except ValueError:
        direction = []
    if len(direction) != 3 or not 1e-3 < math.hypot(*direction) < 1e6:
        raise ValueError(f"{path}: line {line.strip()[:60]!r}, expected a name and a direction x y z; correct it.")
    photo = path.parent / PureWindowsPath(name.strip('"')).name  # either kind of slash
    if not photo.is_file():
        raise ValueError(f"{path}: {photo.name}: no such file beside it, expected the photo; copy it there.")
    return photo, direction
