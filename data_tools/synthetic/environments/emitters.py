"""Lamps, windows and parts of the sky as points and directions that send light.

A scene's extended lights are cut into a number of points that does not depend on the map's size, so that a map costs
little. The sun is not among them; how light reaches surfaces is computed in `light`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from data_tools.synthetic.environments.patterns import luminance
from data_tools.synthetic.environments.scene_geometry import PLANE_AXES, Backdrop, EnvironmentScene, Lamp, Window
from data_tools.synthetic.random_values import Field
from metapp.appearance.latlong import solid_angles, texel_directions

_WIDEST = 1.5  # m, the widest part of a lamp; larger lamps are cut into parts, at most 3 by 3
_WIDEST_PANE = 2.2  # m, the widest part of a window; larger windows are cut into parts, at most 3 by 3
_MOST = 24  # parts of all lamps, and of all windows; where there are more, some stand for several
_GRID = (16, 32)  # directions in which the backdrop is summed up
_CELLS = (2, 8)  # parts of the sky, in height and around, that cast shadows of their own


class Emitters(NamedTuple):
    """A group of K points, or of K directions, that send light.

    Attributes:
        places: [K, 3] in m; if `is_far`, directions instead, each the mean of the directions that it stands for, hence
            shorter than 1.
        normals: [K, 3] of unit length; zeros for emitters that shine to all sides.
        power: [K, 3], radiance times area, or the irradiance by far ones, that reaches places below the emitter.
        power_up: [K, 3], the power that reaches places above the emitter: through a window these see the ground.
        areas: [K] in m^2.
        is_far: whether all are directions.
    """

    places: Field
    normals: Field
    power: Field
    power_up: Field
    areas: Field
    is_far: bool = False


_Row = tuple[Field, Field, Field, Field, float]


def list_emitters(scene: EnvironmentScene) -> list[Emitters]:
    """List all emitters but the sun: the lamps, and the sky or the windows."""
    groups = [[row for lamp in scene.lamps for row in _cut_lamp(lamp)], _cut_windows(scene) if scene.windows else []]
    emitters = [_collect_emitters(group) for group in groups if group]
    return emitters if scene.is_room else [sky_emitters(scene.backdrop), *emitters]


def _collect_emitters(rows: list[_Row]) -> Emitters:
    """Gather emitters from rows; where rows are too many, some stand for several."""
    places, normals, power, power_up, areas = (np.array(column, np.float32) for column in zip(*rows, strict=True))
    step = -(-len(rows) // _MOST)
    representatives = slice(step // 2, None, step)
    scale = power.sum(0) / np.maximum(power[representatives].sum(0), np.float32(1e-9))
    return Emitters(
        places[representatives],
        normals[representatives],
        power[representatives] * scale,
        power_up[representatives] * scale,
        areas[representatives] * step,
    )


def sky_emitters(backdrop: Backdrop) -> Emitters:
    """Cut the view above the horizon into parts, each a direction: its middle by luminance.

    Level ground gets the irradiance of the whole sky.
    """
    (height, width), (cell_rows, cell_columns) = _GRID, _CELLS
    rays = texel_directions(height, width)[:, : height // 2].numpy()
    angles = solid_angles(height, width)[: height // 2].numpy()
    light = backdrop.radiance(rays.reshape(3, -1)).reshape(rays.shape) * angles
    cells = (3, cell_rows, height // 2 // cell_rows, cell_columns, width // cell_columns)
    weights = luminance(light) + np.float32(1e-12)
    places = ((rays * weights).reshape(cells).sum((2, 4)) / weights.reshape(cells[1:]).sum((1, 3))).reshape(3, -1).T
    power = (light * rays[1]).reshape(cells).sum((2, 4)).reshape(3, -1).T / places[:, 1:2]
    return Emitters(places, np.zeros_like(places), power, power, np.ones(len(places), np.float32), is_far=True)


def _cut_rectangle(sizes: tuple[float, float], widest: float) -> list[tuple[float, float]]:
    """Cut a rectangle into equal parts, and return their middles, from -1 to 1 across and along it."""
    counts = [min(3, max(1, math.ceil(size / widest))) for size in sizes]
    across, along = ((2 * np.arange(count) + 1) / count - 1 for count in counts)
    return [(float(x), float(y)) for x in across for y in along]


def _cut_lamp(lamp: Lamp) -> list[_Row]:
    """Cut a lamp into parts, each a row of an emitter's attributes."""
    normal = np.cross(lamp.right, lamp.up)
    normal = normal / np.linalg.norm(normal) * (lamp.shape != "ball")
    parts = _cut_rectangle((2 * lamp.halves[0], 2 * lamp.halves[1]), _WIDEST)
    area = 4 * math.prod(lamp.halves) * (1 if lamp.shape == "panel" else math.pi / 4) / len(parts)
    power = lamp.radiance * np.float32(area)
    return [(lamp.centre + lamp.right * x + lamp.up * y, normal, power, power, area) for x, y in parts]


def _cut_windows(scene: EnvironmentScene) -> list[_Row]:
    """Cut the windows into parts, each a row of an emitter's attributes."""
    rays = texel_directions(*_GRID).flatten(1).numpy()
    angles = solid_angles(*_GRID).expand(*_GRID).flatten().numpy()
    light = scene.backdrop.radiance(rays)
    return [row for window in scene.windows for row in _cut_window(scene, window, rays, light, angles)]


def _cut_window(scene: EnvironmentScene, window: Window, rays: Field, light: Field, angles: Field) -> list[_Row]:
    """Cut a window into parts, which send the mean of the view above the horizon downwards and below it upwards."""
    axis, sign = window.side // 2, 1 if window.side % 2 else -1
    weights = np.maximum(sign * rays[axis], 0) * angles
    radiance_above, radiance_below = (
        light @ (weight / max(float(weight.sum()), 1e-6)) * window.glass
        for weight in (weights * (rays[1] > 0), weights * (rays[1] <= 0))
    )
    sizes = (window.high[0] - window.low[0], window.high[1] - window.low[1])
    parts = _cut_rectangle(sizes, _WIDEST_PANE)
    area = math.prod(sizes) / len(parts)
    normal = np.zeros(3, np.float32)
    normal[axis] = -sign
    rows = []
    for x, y in parts:
        place = (scene.high if sign > 0 else scene.low).copy()
        place[list(PLANE_AXES[axis])] = [
            low + (position + 1) / 2 * size for low, position, size in zip(window.low, (x, y), sizes, strict=True)
        ]
        rows.append((place, normal, radiance_above * np.float32(area), radiance_below * np.float32(area), area))
    return rows
