"""The default illumination set: procedural environments out of doors, indoors and in studios, each with sphere photos.

Families take turns, so any count of 16 or more holds them all; every draw is another place. Training and test draws
come from other random streams.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
import torch
from torch import Tensor

from data_tools.random_streams import Rng
from data_tools.readers import environment_maps
from data_tools.synthetic.environments.indoor import apartment, evening, lobby, office, studio, warehouse, workshop
from data_tools.synthetic.environments.light import render_environment
from data_tools.synthetic.environments.outdoor import (
    courtyard,
    dull,
    dusk,
    forest,
    meadow,
    night,
    shore,
    square,
    street,
)
from data_tools.synthetic.environments.patterns import vector
from data_tools.synthetic.environments.scene_geometry import EnvironmentScene
from data_tools.synthetic.random_values import Field, Split, between, chance
from data_tools.synthetic.stationary.families import split_draws
from metapp.appearance.latlong import solid_angles
from metapp.learning.task import Task

_STRONGEST_CAST = 1.2  # the largest ratio of red to blue in the mean of a map, or its inverse, as a power of 2

VERSION = 1  # of the set's tasks; 2 was drawn for a time with 8 of the families, so that the next is 3
ROWS = environment_maps.MAP_HEIGHT_PX  # rows of a map
UNITS = {**environment_maps.UNITS, "scale": "mean luminance of the map before, kcd/m^2, about"}
COUNTS: dict[Split, int] = {"train": 900, "test": 16}
FAMILIES: dict[str, Callable[[Rng], EnvironmentScene]] = {
    "meadow": meadow,
    "apartment": apartment,
    "street": street,
    "studio": studio,
    "courtyard": courtyard,
    "office": office,
    "forest": forest,
    "workshop": workshop,
    "shore": shore,
    "evening": evening,
    "square": square,
    "warehouse": warehouse,
    "dusk": dusk,
    "lobby": lobby,
    "dull": dull,
    "night": night,
}


def synthetic_tasks(split: Split, count: int, seed: int = 0, rows: int = ROWS) -> Iterator[Task]:
    """Draw the environments of one split, and yield each as a task.

    Args:
        split: "train" or "test"; both have all families, with other draws.
        count: how many. A larger set begins with the smaller one.
        seed: seed of all draws, >= 0.
        rows: rows of the maps, at least 32; a seed's environments do not depend on it.

    Returns:
        Tasks with unique names such as "meadow-016" ("meadow-t000" in the test split), as
        `data_tools.readers.environment_maps.make_map_task` makes them from a file.

    Raises:
        ValueError: for another split, or a negative count or seed.
    """
    for family, name, rng in split_draws("environments", FAMILIES, COUNTS, split, count, seed):
        light = draw_environment_map(FAMILIES[family], rng, 2 * max(1, math.ceil(rows / ROWS)), rows)
        yield environment_maps.make_map_task(name, light, rng, rows)


def draw_environment_map(
    family: Callable[[Rng], EnvironmentScene], rng: Rng, supersampling: int = 2, rows: int = ROWS
) -> Tensor:
    """Draw a scene of a family, and render its map, turned at random and seen by a camera of some white balance.

    Returns:
        Radiance, float32 [3, rows, 2 * rows], kcd/m^2.
    """
    scene = family(rng)
    light = render_environment(scene, between(rng, 0, math.tau), supersampling, rows)
    return torch.from_numpy(light * draw_white_balance(light, rng)[:, None, None])


def draw_white_balance(light: Field, rng: Rng) -> Field:
    """Draw the gains [3] of a camera's white balance for a map [3, H, W].

    They make the mean of the map grey, more or less, and a little off.
    """
    weights = solid_angles(*light.shape[1:]).numpy() / light.shape[2]
    mean = np.maximum((light * weights).sum((1, 2)), 1e-9)
    cast_exponent = between(rng, 0.05, 0.7) if chance(rng, 0.9) else 1.0
    cast_exponent = min(cast_exponent, _STRONGEST_CAST / max(abs(math.log2(mean[0] / mean[2])), 1e-3))
    warmth, green = between(rng, -0.2, 0.3), between(rng, -0.06, 0.06)
    gains = (mean / mean[1]) ** (cast_exponent - 1) * vector(2**warmth, 2**green, 2**-warmth)
    result: Field = np.clip(gains, 0.2, 5).astype(np.float32)
    return result
