"""Outdoor scenes: ground, houses, walls, roofs, vehicles, trees.

Functions named `add_...` draw things and add them to a scene; boxes that the eye would be in are left out.
"""

from __future__ import annotations

import math

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.environments.backdrop import open_ground, skyline
from data_tools.synthetic.environments.patterns import BLACK, direction, vector
from data_tools.synthetic.environments.scene_geometry import Box, Crown, EnvironmentScene, Finish
from data_tools.synthetic.environments.sky import Sky
from data_tools.synthetic.random_values import Field, between, chance, integer_between, log_between, pick, uniforms
from data_tools.synthetic.stationary.periodic_maps import Range

_Colours = tuple[tuple[float, float, float], tuple[float, float, float]]  # darkest and lightest albedo
_GROUNDS: dict[str, _Colours] = {
    "grass": ((0.03, 0.055, 0.015), (0.16, 0.2, 0.07)),
    "meadow": ((0.06, 0.07, 0.02), (0.25, 0.22, 0.11)),
    "dirt": ((0.08, 0.055, 0.035), (0.26, 0.19, 0.13)),
    "sand": ((0.25, 0.2, 0.14), (0.5, 0.42, 0.31)),
    "snow": ((0.6, 0.62, 0.66), (0.88, 0.88, 0.89)),
    "asphalt": ((0.05, 0.05, 0.05), (0.18, 0.175, 0.17)),
    "concrete": ((0.18, 0.175, 0.165), (0.42, 0.41, 0.39)),
    "gravel": ((0.12, 0.11, 0.1), (0.35, 0.33, 0.3)),
}
_WALLS: tuple[_Colours, ...] = (  # brick, plaster, concrete, wood
    ((0.16, 0.07, 0.05), (0.4, 0.22, 0.16)),
    ((0.35, 0.3, 0.22), (0.7, 0.66, 0.58)),
    ((0.15, 0.15, 0.15), (0.45, 0.44, 0.42)),
    ((0.1, 0.07, 0.05), (0.35, 0.25, 0.17)),
)
_HEDGE = Finish(vector(0.05, 0.08, 0.02), vector(0.12, 0.15, 0.05), "leaves", 6)

EYE_CLEARANCE_M = 0.4  # distance of the eye from boxes
NATURAL_GROUNDS = ("grass", "grass", "grass", "meadow", "meadow", "dirt", "dirt", "sand", "snow", "gravel")
PAVED_GROUNDS = ("asphalt", "asphalt", "concrete", "concrete", "gravel")


def draw_open_scene(
    rng: Rng,
    sky: Sky,
    grounds: tuple[str, ...],
    skylines: tuple[str, ...],
    height: Range,
    window_radiance: Field = BLACK,
) -> EnvironmentScene:
    """Draw level ground to the horizon, and the distance behind it.

    Args:
        rng: random numbers for all choices.
        sky: the sky above.
        grounds: kinds of ground to choose from.
        skylines: things at the horizon to choose from: "hills", "woods", "town", "none".
        height: range of the sine of the elevation that the things at the horizon reach.
        window_radiance: radiance [3] of the lit windows of a town at the horizon.
    """
    kind, level = pick(rng, grounds), 0.7 * float(rng.random()) ** 1.5
    first, second = (_mix_colours(_GROUNDS[kind], share) for share in (level, level + 0.3))
    pattern = "leaves" if kind in ("grass", "meadow", "dirt") else pick(rng, ("rough", "soft", "cloud"))
    ground = Finish(first, second, pattern, log_between(rng, 4, 30))
    skyline_kind, mean = pick(rng, skylines), (first + second) / 2
    backdrop = open_ground(sky, mean)
    if skyline_kind != "none":
        backdrop = skyline(rng, sky, mean, skyline_kind, log_between(rng, *height), window_radiance)
    low = vector(-np.inf, -between(rng, 1.2, 2.2), -np.inf)
    return EnvironmentScene(low, np.full(3, np.inf, np.float32), [ground] * 6, backdrop, kept_light_share=0.3)


def _mix_colours(colours: _Colours, share: float) -> Field:
    """Mix the darkest and the lightest colour of a material; share 0 is the darkest."""
    dark, light = (vector(*colour) for colour in colours)
    return dark + (light - dark) * np.float32(share)


def _draw_wall_finish(rng: Rng) -> Finish:
    """Draw the finish of a wall: brick, plaster, concrete or wood."""
    colour = _mix_colours(pick(rng, _WALLS), float(rng.random()))
    pattern = pick(rng, ("rough", "cloud"))
    return Finish(colour, colour * np.float32(between(rng, 0.5, 0.9)), pattern, between(rng, 3, 12))


def _draw_facade_finish(rng: Rng, window_radiance: Field) -> Finish:
    """Draw the finish of a wall with rows of windows, of which the lit ones have the radiance [3]."""
    glazed = (between(rng, 0.4, 0.9), between(rng, 0.3, 0.95))
    return _draw_wall_finish(rng)._replace(
        window_spacing_m=(between(rng, 2.6, 3.8), between(rng, 1.4, 4)),
        window_share=glazed,
        window_radiance=window_radiance,
    )


def add_street_houses(rng: Rng, scene: EnvironmentScene, window_radiance: Field = BLACK) -> None:
    """Add houses on both sides of a street along the z axis; their lit windows have the radiance [3]."""
    bottom, height = float(scene.low[1]), log_between(rng, 5, 24)
    for sign in (-1, 1):
        front, start, gaps = between(rng, 3.5, 13), between(rng, -75, -60), chance(rng, 0.5)
        if chance(rng, 0.1):
            continue
        x = sorted((sign * front, sign * (front + 14)))
        while start < 60:
            end, top = start + between(rng, 9, 30), bottom + height * between(rng, 0.6, 1.4)
            scene.boxes.append(
                Box(vector(x[0], bottom, start), vector(x[1], top, end), _draw_facade_finish(rng, window_radiance))
            )
            start = end + (between(rng, 4, 12) if gaps and chance(rng, 0.4) else 0)
        if chance(rng, 0.4):
            for number in range(-2, 3):
                _add_tree(rng, scene, sign * (front - 2), number * 9 + between(rng, -3, 3), between(rng, 1.2, 2.2))
    add_vehicles(rng, scene, integer_between(rng, 0, 6), (2.5, 20), along_street=True)
    scene.kept_light_share = 0.7


def add_surrounding_houses(rng: Rng, scene: EnvironmentScene, distance: float, window_radiance: Field = BLACK) -> None:
    """Add houses all around, about `distance` metres from the eye; their lit windows have the radiance [3]."""
    bottom, count, height = float(scene.low[1]), integer_between(rng, 4, 10), distance * between(rng, 0.3, 1.0)
    for number in range(count):
        angle = (number + between(rng, -0.3, 0.3)) * math.tau / count
        centre = direction(0, angle) * np.float32(distance * between(rng, 1, 1.6))
        half = vector(*(distance * between(rng, 0.12, 0.35) for _ in range(3)))
        low, high = centre - half, centre + half
        low[1], high[1] = bottom, bottom + height * between(rng, 0.4, 1.4)
        scene.add_box(EYE_CLEARANCE_M, Box(low, high, _draw_facade_finish(rng, window_radiance)))
    add_trees(rng, scene, integer_between(rng, 0, 6), (6, distance))
    add_garden_walls(rng, scene, integer_between(rng, 0, 2))
    add_bushes(rng, scene, integer_between(rng, 0, 3), (4, distance))
    add_vehicles(rng, scene, integer_between(rng, 0, 6), (4, distance))


def add_courtyard_walls(rng: Rng, scene: EnvironmentScene) -> None:
    """Add houses or walls close by, on up to four sides."""
    plain, height, bottom = _draw_wall_finish(rng), between(rng, 2.5, 9), float(scene.low[1])
    for axis, sign in ((0, -1), (0, 1), (2, -1), (2, 1)):
        if chance(rng, 0.15):
            continue
        distance, length = between(rng, 3, 11), between(rng, 6, 16)
        finish = plain._replace(window_spacing_m=(3.0, between(rng, 2, 4))) if chance(rng, 0.6) else plain
        low = vector(-length, bottom, -length)
        high = vector(length, bottom + height * between(rng, 0.6, 1.2), length)
        low[axis], high[axis] = sorted((sign * distance, sign * (distance + 5)))
        scene.boxes.append(Box(low, high, finish))
    scene.kept_light_share = 0.8


def add_porch(rng: Rng, scene: EnvironmentScene) -> None:
    """Add a roof or a bridge over the eye, on posts, sometimes with a wall."""
    underside, bottom, finish = between(rng, 0.8, 2.5), float(scene.low[1]), _draw_wall_finish(rng)
    reach = 20.0 if chance(rng, 0.3) else 7.0
    x, z = (sorted(log_between(rng, 1.2, reach) * sign for sign in (-1, 1)) for _ in range(2))
    scene.boxes.append(Box(vector(x[0], underside, z[0]), vector(x[1], underside + 0.3, z[1]), finish))
    for post_z in np.linspace(z[0] + 0.2, z[1] - 0.2, integer_between(rng, 2, 5)).tolist():
        for edge in x if chance(rng, 0.5) else x[:1]:
            low, high = vector(edge - 0.15, bottom, post_z - 0.15), vector(edge + 0.15, underside, post_z + 0.15)
            scene.add_box(EYE_CLEARANCE_M, Box(low, high, finish))
    if chance(rng, 0.5):
        scene.add_box(
            EYE_CLEARANCE_M,
            Box(vector(x[0] - 0.4, bottom, z[0]), vector(x[0] - 0.1, underside, z[1]), _draw_wall_finish(rng)),
        )


def add_vehicles(rng: Rng, scene: EnvironmentScene, count: int, distance: Range, along_street: bool = False) -> None:
    """Add boxes as large as cars and bins.

    Args:
        rng: random numbers for their places, sizes and colours.
        scene: the scene; boxes are added to it.
        count: how many.
        distance: range of their distance from the eye in m; along a street, their distance from its middle, and the
            farthest along it.
        along_street: whether they stand along both sides of a street along the z axis, or anywhere.
    """
    for _ in range(count):
        bright = uniforms(rng, 3) if chance(rng, 0.3) else 1 + uniforms(rng, 3) * np.float32(0.15)
        colour = np.clip(bright * np.float32(log_between(rng, 0.03, 0.5)), 0.02, 0.8)
        half = vector(0.9, between(rng, 0.5, 1), between(rng, 0.6, 2.2))
        centre = direction(0, between(rng, 0, math.tau)) * np.float32(between(rng, *distance))
        if along_street:  # the centre above is drawn in any case: without it, later draws of the set would be others
            centre = vector(pick(rng, (-1, 1)) * distance[0], 0, between(rng, -distance[1], distance[1]))
        elif chance(rng, 0.5):
            half = half[[2, 1, 0]]
        centre[1] = scene.low[1] + half[1]
        scene.add_box(EYE_CLEARANCE_M, Box(centre - half, centre + half, Finish(colour, gloss=0.05)))


def add_garden_walls(rng: Rng, scene: EnvironmentScene, count: int) -> None:
    """Add garden walls, fences, hedges and sheds, straight, at some distance."""
    bottom = float(scene.low[1])
    for _ in range(count):
        start, length, distance = (
            between(rng, -25, 10),
            log_between(rng, 2, 40),
            log_between(rng, 3, 20) * pick(rng, (-1, 1)),
        )
        low, high = (
            vector(start, bottom, min(distance, distance * 1.1)),
            vector(start + length, 0, max(distance, distance * 1.1)),
        )
        high[1] = bottom + log_between(rng, 0.6, 3.5)
        if chance(rng, 0.5):
            low, high = low[[2, 1, 0]], high[[2, 1, 0]]
        finish = _draw_wall_finish(rng) if chance(rng, 0.7) else _HEDGE
        if chance(rng, 0.4):
            pattern, size = pick(rng, ("stripes", "patches")), log_between(rng, 0.6, 6)
            finish = finish._replace(second_colour=finish.colour * np.float32(0.2), pattern=pattern, size=size)
        scene.add_box(EYE_CLEARANCE_M, Box(low, high, finish))


def add_paths(rng: Rng, scene: EnvironmentScene, count: int) -> None:
    """Add straight roads, paths or strips of another ground, flat."""
    bottom = float(scene.low[1])
    for _ in range(count):
        colours = _GROUNDS[pick(rng, (*PAVED_GROUNDS, "dirt", "meadow"))]
        finish = Finish(_mix_colours(colours, between(rng, 0, 0.6)), vector(*colours[0]), size=between(rng, 3, 10))
        start, width = between(rng, -15, 12), log_between(rng, 1, 9)
        low, high = vector(start, bottom - 1, -500), vector(start + width, bottom + 0.02, 500)
        if chance(rng, 0.3):
            low, high = low[[2, 1, 0]], high[[2, 1, 0]]
        scene.boxes.append(Box(low, high, finish))


def add_trees(rng: Rng, scene: EnvironmentScene, count: int, distance: Range, radius: Range = (1.2, 3.5)) -> None:
    """Add trees at distances in m from the range, with crowns of radii in m from the range."""
    for _ in range(count):
        x, _, z = (direction(0, between(rng, 0, math.tau)) * np.float32(log_between(rng, *distance))).tolist()
        _add_tree(rng, scene, x, z, between(rng, *radius))


def _add_tree(rng: Rng, scene: EnvironmentScene, x: float, z: float, radius: float) -> None:
    """Add a tree, a crown on a trunk, at x and z in m."""
    radius = min(radius, 0.6 * math.hypot(x, z))
    top = float(scene.low[1]) + radius * between(rng, 1.2, 2.6)
    scene.crowns.append(Crown(vector(x, top, z), radius, _draw_leaf_colour(rng)))
    trunk = vector(0.06, 0, 0.06) * np.float32(1 + radius)
    bark = Finish(vector(0.09, 0.07, 0.05) * np.float32(between(rng, 0.5, 2)))
    scene.add_box(EYE_CLEARANCE_M, Box(vector(x, scene.low[1], z) - trunk, vector(x, top, z) + trunk, bark))


def add_bushes(rng: Rng, scene: EnvironmentScene, count: int, distance: Range) -> None:
    """Add bushes at distances in m from the range."""
    for _ in range(count):
        bush_distance = log_between(rng, *distance)
        centre, radius = (
            direction(0, between(rng, 0, math.tau)) * np.float32(bush_distance),
            min(between(rng, 0.5, 1.8), bush_distance / 2),
        )
        centre[1] = scene.low[1] + 0.5 * radius
        scene.crowns.append(Crown(centre, radius, _draw_leaf_colour(rng)))


def _draw_leaf_colour(rng: Rng) -> Field:
    """Draw the albedo [3] of foliage."""
    return vector(between(rng, 0.45, 1.0), 1, between(rng, 0.15, 0.5)) * np.float32(between(rng, 0.05, 0.14))
