"""Photographs by a camera that stands still under a lamp that moves, with a text of the lamp's directions (RTI).

Reflectance transformation imaging (Malzbender et al. 2001) is how museums photograph relief: the camera looks straight
down, the light comes from a dome or a lamp that is carried around, and programs such as RTIBuilder and Relight write a
file `.lp`: the number of photographs, then for each its name and the direction to the light, x right, y up, z towards
the camera. `light_lines` parses it, `named_photos` finds its photographs, and `light_axes` tells by photographs whether
its axes are others.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import normalize

from data_tools.readers.light_lines import LightLine, list_first, read_light_lines
from data_tools.readers.named_photos import LEAST_PHOTOS, find_named_photos
from metapp.storage.folders import list_folder

LIGHT_DIRECTIONS_SUFFIX = ".lp"  # of a text beside photographs by a camera that stands still
GRAZING_SINE = math.sin(math.radians(10))  # of the angle of a light with the material: lower ones leave it in shadow


class Lights(NamedTuple):
    """Photographs under one light each.

    Attributes:
        photos: the files.
        directions: unit vectors towards the lights, x right, y up, z towards the camera, [N, 3].
        notes: messages for the user of what was taken otherwise than the text states.
    """

    photos: list[Path]
    directions: Tensor
    notes: list[str]


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


def read_lights(path: Path) -> Lights:
    """Read a text of light directions, which does not tell how far the lights are.

    Photographs are looked for by their names beside the text, whatever folder the text states, since such texts are
    moved with their photographs. Lights below the material are left out; if all are, their directions are turned round.

    Args:
        path: the text; see :func:`read_light_lines`.

    Raises:
        ValueError: the text cannot be read, a line is malformed, or too few photographs or lights are left.
    """
    lines, notes = read_light_lines(path)
    photos, name_notes = find_named_photos(path, lines)
    directions = normalize(torch.tensor([line.direction for line in photos], dtype=torch.float64), dim=1).float()
    directions, below, notes_below = _turn_up(path, list(photos), directions)
    files = [file for file, is_below in zip(photos.values(), below, strict=True) if not is_below]
    return Lights(files, directions, [*notes, *name_notes, *notes_below])


def _turn_up(path: Path, lines: list[LightLine], directions: Tensor) -> tuple[Tensor, list[bool], list[str]]:
    """Turn directions round that all lead from the lamp to the material, or leave out those below the material.

    Returns:
        The directions that are left, whether each line is left out, and messages for the user.

    Raises:
        ValueError: too few are left.
    """
    heights = directions[:, 2]
    if not bool((heights > GRAZING_SINE).any()) and bool((heights < -GRAZING_SINE).any()):
        found = (
            f"z is below 0 in {int((heights < 0).sum())} of {len(lines)} directions, as from the lamp to the material"
        )
        note = f"{path}: {found}, expected z towards the camera; taken: the opposite directions."
        directions, below, notes = _turn_up(path, lines, -directions)
        return directions, below, [note, *notes]
    below = (heights <= 0).tolist()
    if not any(below):
        return directions, below, []
    places = list_first([line for line, is_below in zip(lines, below, strict=True) if is_below])
    found = f"{sum(below)} of {len(lines)} lamps are not above the material (z is 0 or less): {places}"
    if len(lines) - sum(below) < LEAST_PHOTOS:
        raise ValueError(f"{path}: {found}, expected {LEAST_PHOTOS} or more above it; correct their directions.")
    return directions[heights > 0], below, [f"{path}: {found}; left out: correct their directions."]
