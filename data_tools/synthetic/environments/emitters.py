"""Lamps, windows and parts of the sky as points and directions that send light."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from data_tools.synthetic.environments.patterns import luminance
from data_tools.synthetic.environments.scene_geometry import PLANE_AXES, Backdrop, EnvironmentScene, Lamp, Window
from data_tools.synthetic.random_values import Field
from metapp.appearance.latlong import solid_angles, texel_directions

_WIDEST = 1.5  # m; larger lamps are cut into parts, at most 3 by 3
_WIDEST_PANE = 2.2  # m; the same of windows
_MOST = 24  # lamps' parts, and windows' parts; where there are more, some stand for several
_GRID = (16, 32)  # directions in which the backdrop is summed up
_CELLS = (2, 8)  # parts of the sky, in height and around, that cast shadows of their own


class Emitters(NamedTuple):
    """K points, or directions, that send light.

    Attributes:
        places: [K, 3] m; if `far`, directions, shorter than 1 as those that each stands for differ.
        normals: [K, 3] unit length; zeros for sources that shine to all sides.
        power: [K, 3] radiance times area, or irradiance of far ones, that they send to places below them.
        power_up: the same to places above: through a window these see the ground.
        areas: [K] m^2.
        far: whether all are directions.
    """

    places: Field
    normals: Field
    power: Field
    power_up: Field
    areas: Field
    far: bool = False


_Row = tuple[Field, Field, Field, Field, float]


def list_emitters(scene: EnvironmentScene) -> list[Emitters]:
    """All that sends light, but the sun: lamps, and the sky or the windows."""
    rows = [[row for lamp in scene.lamps for row in _lamp(lamp)], _windows(scene) if scene.windows else []]
    found = [_collected(each) for each in rows if each]
    return found if scene.is_room else [sky_emitters(scene.backdrop), *found]


def _collected(rows: list[_Row]) -> Emitters:
    places, normals, power, power_up, areas = (np.array(column, np.float32) for column in zip(*rows, strict=True))
    step = -(-len(rows) // _MOST)
    kept = slice(step // 2, None, step)
    scale = power.sum(0) / np.maximum(power[kept].sum(0), np.float32(1e-9))
    return Emitters(places[kept], normals[kept], power[kept] * scale, power_up[kept] * scale, areas[kept] * step)


def sky_emitters(backdrop: Backdrop) -> Emitters:
    """Parts of the view above the horizon, each a direction, in its middle by luminance.

    Level ground gets the irradiance of the whole sky.
    """
    (height, width), (bands, around) = _GRID, _CELLS
    rays = texel_directions(height, width)[:, : height // 2].numpy()
    angles = solid_angles(height, width)[: height // 2].numpy()
    light = backdrop.radiance(rays.reshape(3, -1)).reshape(rays.shape) * angles
    cells = (3, bands, height // 2 // bands, around, width // around)
    weights = luminance(light) + np.float32(1e-12)
    places = ((rays * weights).reshape(cells).sum((2, 4)) / weights.reshape(cells[1:]).sum((1, 3))).reshape(3, -1).T
    power = (light * rays[1]).reshape(cells).sum((2, 4)).reshape(3, -1).T / places[:, 1:2]
    return Emitters(places, np.zeros_like(places), power, power, np.ones(len(places), np.float32), far=True)


def _cut(sizes: tuple[float, float], widest: float) -> list[tuple[float, float]]:
    """The middles of a rectangle's equal parts, from -1 to 1 across and along it."""
    counts = [min(3, max(1, math.ceil(size / widest))) for size in sizes]
    across, along = ((2 * np.arange(count) + 1) / count - 1 for count in counts)
    return [(float(x), float(y)) for x in across for y in along]


def _lamp(lamp: Lamp) -> list[_Row]:
    normal = np.cross(lamp.right, lamp.up)
    normal = normal / np.linalg.norm(normal) * (lamp.shape != "ball")
    parts = _cut((2 * lamp.halves[0], 2 * lamp.halves[1]), _WIDEST)
    area = 4 * math.prod(lamp.halves) * (1 if lamp.shape == "panel" else math.pi / 4) / len(parts)
    power = lamp.radiance * np.float32(area)
    return [(lamp.centre + lamp.right * x + lamp.up * y, normal, power, power, area) for x, y in parts]


def _windows(scene: EnvironmentScene) -> list[_Row]:
    rays = texel_directions(*_GRID).flatten(1).numpy()
    angles = solid_angles(*_GRID).expand(*_GRID).flatten().numpy()
    light = scene.backdrop.radiance(rays)
    return [row for window in scene.windows for row in _window(scene, window, rays, light, angles)]


def _window(scene: EnvironmentScene, window: Window, rays: Field, light: Field, angles: Field) -> list[_Row]:
    """Parts of a window, which send the mean of the view above the horizon downwards, of that below upwards."""
    axis, sign = window.side // 2, 1 if window.side % 2 else -1
    weights = np.maximum(sign * rays[axis], 0) * angles
    above, below = (
        light @ (part / max(float(part.sum()), 1e-6)) * window.glass
        for part in (weights * (rays[1] > 0), weights * (rays[1] <= 0))
    )
    sizes = (window.high[0] - window.low[0], window.high[1] - window.low[1])
    parts = _cut(sizes, _WIDEST_PANE)
    area = math.prod(sizes) / len(parts)
    normal = np.zeros(3, np.float32)
    normal[axis] = -sign
    rows = []
    for x, y in parts:
        place = (scene.high if sign > 0 else scene.low).copy()
        place[list(PLANE_AXES[axis])] = [
            low + (at + 1) / 2 * size for low, at, size in zip(window.low, (x, y), sizes, strict=True)
        ]
        rows.append((place, normal, above * np.float32(area), below * np.float32(area), area))
    return rows
