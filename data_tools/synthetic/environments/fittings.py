"""Rooms and their fittings: windows, lamps, beams, doors, furniture.

Functions named `add_...` draw things and add them to a scene; boxes that the eye would be in are left out.
"""

from __future__ import annotations

import math

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.environments.patterns import black_body_rgb, direction, vector
from data_tools.synthetic.environments.scene_geometry import (
    PLANE_AXES,
    Backdrop,
    Box,
    EnvironmentScene,
    Finish,
    Lamp,
    Window,
)
from data_tools.synthetic.random_values import Field, between, chance, integer_between, log_between, pick, uniforms
from data_tools.synthetic.stationary.periodic_maps import Range

EYE_CLEARANCE_M = 0.5  # distance of the eye from boxes
WALL_SIDES = (0, 1, 4, 5)  # numbers of the sides of a room that are walls


def draw_near_white(rng: Rng, strength: float) -> Field:
    """Draw a colour [3] near white, whose channels differ from 1 by at most `strength`."""
    return 1 + (uniforms(rng, 3) - np.float32(0.5)) * np.float32(2 * strength)


def draw_room(
    rng: Rng, sizes: tuple[Range, Range, Range], backdrop: Backdrop, is_hall: bool = False
) -> EnvironmentScene:
    """Draw an empty room around the eye.

    Args:
        rng: random numbers for all choices.
        sizes: ranges of width, depth and height in m.
        backdrop: the view outside.
        is_hall: whether it is a hall for work rather than a room to live in.
    """
    size = vector(log_between(rng, *sizes[0]), between(rng, *sizes[2]), log_between(rng, *sizes[1]))
    eye = vector(between(rng, 0.2, 0.8), 0, between(rng, 0.2, 0.8)) * size
    eye[1] = min(between(rng, 1.1, 1.8), float(size[1]) - 0.8)
    warm = vector(1.06, 1, 0.9) if chance(rng, 0.5) else vector(1, 1, 1)
    wall = Finish(
        warm * draw_near_white(rng, 0.05) * np.float32(between(rng, 0.15, 0.55) if is_hall else between(rng, 0.3, 0.78))
    )
    if is_hall or chance(rng, 0.2):
        wall = _add_second_colour(rng, wall, ("cloud", "stripes", "tiles", "patches"), (1, 8))
    ceiling = Finish(warm * np.float32(between(rng, 0.1, 0.5) if is_hall else between(rng, 0.5, 0.85)))
    if chance(rng, 0.3):
        ceiling = _add_second_colour(rng, ceiling, ("tiles", "stripes"), (0.6, 3))
    sides = [wall, wall, _draw_floor(rng, is_hall), ceiling, wall, wall]
    if chance(rng, 0.35):
        sides[pick(rng, WALL_SIDES)] = Finish(
            draw_near_white(rng, pick(rng, (0.2, 0.4, 0.8))) * np.float32(between(rng, 0.15, 0.5))
        )
    return EnvironmentScene(-eye, size - eye, sides, backdrop)


def _add_second_colour(rng: Rng, finish: Finish, patterns: tuple[str, ...], size: Range) -> Finish:
    """Give a finish a second, darker colour, in one of some patterns with a period from `size` in m."""
    other = finish.colour * np.float32(0.6)
    return finish._replace(second_colour=other, pattern=pick(rng, patterns), size=between(rng, *size))


def _draw_floor(rng: Rng, is_hall: bool) -> Finish:
    """Draw the finish of a floor: concrete for a hall, else wood, tiles or carpet."""
    gloss = pick(rng, (0.0, 0.0, 0.01, 0.02, 0.04))
    if is_hall:
        colour: Field = vector(0.3, 0.29, 0.27) * draw_near_white(rng, 0.06) * np.float32(log_between(rng, 0.4, 1.6))
        if chance(rng, 0.3):
            colour = vector(*pick(rng, ((0.06, 0.2, 0.08), (0.3, 0.1, 0.06), (0.1, 0.14, 0.25))))
        return _add_second_colour(rng, Finish(colour, gloss=gloss), ("rough", "cloud", "tiles"), (2, 9))
    if chance(rng, 0.5):
        wood = vector(0.38, 0.23, 0.12) * draw_near_white(rng, 0.15) * np.float32(log_between(rng, 0.3, 1.4))
        return _add_second_colour(rng, Finish(wood, gloss=gloss), ("planks",), (1.5, 4))
    if chance(rng, 0.5):
        tile = draw_near_white(rng, 0.1) * np.float32(log_between(rng, 0.1, 0.75))
        return _add_second_colour(rng, Finish(tile, gloss=gloss), ("tiles", "chequers"), (0.4, 1.2))
    carpet = draw_near_white(rng, 0.3) * np.float32(log_between(rng, 0.06, 0.4))
    return _add_second_colour(rng, Finish(carpet), ("rough",), (1, 4))


def add_windows(rng: Rng, scene: EnvironmentScene, side: int, count: int, sill: Range, share: Range) -> None:
    """Add windows in a row to a side of a room.

    Args:
        rng: random numbers for their sizes and their glass.
        scene: the room; windows are added to it.
        side: number of the side.
        count: how many.
        sill: range of the height of their lower edge above the floor, m.
        share: range of the share of the wall's width that they take.
    """
    across = PLANE_AXES[side // 2][0]
    left, width = float(scene.low[across]), float(scene.high[across] - scene.low[across]) / count
    part, bottom = between(rng, *share), float(scene.low[1]) + between(rng, *sill)
    head = bottom + (float(scene.high[1]) - 0.1 - bottom) * between(rng, 0.6, 1)
    glass = draw_near_white(rng, 0.04) * np.float32(between(rng, 0.5, 0.92))
    if chance(rng, 0.2):
        glass = glass * np.float32(0.25)  # curtains
    shift, bars = between(rng, -0.5, 0.5) * (1 - part), (integer_between(rng, 1, 2), pick(rng, (1, 1, 2)))
    for number in range(count):
        middle, half = left + (number + 0.5 + shift) * width, part * width / 2
        scene.windows.append(Window(side, (middle - half, bottom), (middle + half, head), glass, bars))


def add_skylights(rng: Rng, scene: EnvironmentScene) -> None:
    """Add long windows in the ceiling."""
    count, glass = integer_between(rng, 1, 4), vector(1, 1, 1) * np.float32(between(rng, 0.2, 0.8))
    width, length = (float(scene.high[axis] - scene.low[axis]) for axis in (0, 2))
    half_width, z = between(rng, 0.05, 0.25) * width / count, float(scene.low[2]) + 0.1 * length
    for number in range(count):
        x = float(scene.low[0]) + (number + 0.5) / count * width
        scene.windows.append(
            Window(3, (x - half_width, z), (x + half_width, z + 0.8 * length), glass, (1, integer_between(rng, 1, 6)))
        )


def add_ceiling_lamps(
    rng: Rng,
    scene: EnvironmentScene,
    grid: tuple[int, int],
    halves: Range,
    flux: Range,
    kelvin: float,
    shape: str = "panel",
) -> None:
    """Add lamps under the ceiling that shine downwards.

    Args:
        rng: random numbers for their flux, how deep they hang and which of them are off.
        scene: the room; lamps are added to it.
        grid: how many across and along the room.
        halves: half of their width and depth in m.
        flux: range of their luminous flux, klm.
        kelvin: colour temperature of their light.
        shape: "panel" or "disc".
    """
    area = 4 * math.prod(halves) * (1 if shape == "panel" else math.pi / 4)
    radiance = black_body_rgb(kelvin) * np.float32(log_between(rng, *flux) / (math.pi * area))
    drop = between(rng, 0, 0.25) * float(scene.high[1]) if chance(rng, 0.3) else 0.0
    off_share = between(rng, 0, 0.4) if chance(rng, 0.3) else 0.0
    for column in range(grid[0]):
        for row in range(grid[1]):
            share = vector((column + 0.5) / grid[0], 1, (row + 0.5) / grid[1])
            centre = scene.low + (scene.high - scene.low) * share - vector(0, 0.03 + drop, 0)
            if not chance(rng, off_share):
                scene.lamps.append(Lamp(centre, vector(halves[0], 0, 0), vector(0, 0, halves[1]), radiance, shape))


def add_downlights(
    rng: Rng, scene: EnvironmentScene, columns: int, rows: int, radius: Range, flux: Range, kelvin: float
) -> None:
    """Add round ceiling lamps with a radius in m and a flux in klm from the ranges."""
    half = log_between(rng, *radius)
    add_ceiling_lamps(rng, scene, (columns, rows), (half, half), flux, kelvin, "disc")


def add_bulb(rng: Rng, scene: EnvironmentScene, flux: Range, radius: Range, kelvin: float) -> None:
    """Add a lamp that shines to all sides, anywhere in the room: on the floor, a table, a wall, or hanging.

    Its flux is in klm and its radius in m.
    """
    half = log_between(rng, *radius)
    centre = scene.low + (scene.high - scene.low) * (np.float32(0.06) + np.float32(0.88) * uniforms(rng, 3))
    centre = centre * np.float32(max(1.0, (1 + half) / float(np.linalg.norm(centre))))
    centre = np.clip(centre, scene.low + 0.05, scene.high - 0.05)
    radiance = black_body_rgb(kelvin) * np.float32(log_between(rng, *flux) / (2 * math.pi * half) ** 2)
    scene.lamps.append(Lamp(centre, vector(half, 0, 0), vector(0, half, 0), radiance, "ball"))


def add_softbox(rng: Rng, scene: EnvironmentScene, kelvin: float) -> None:
    """Add a large lamp that points to the middle, from anywhere but below; one in four is coloured."""
    centre = direction(between(rng, -0.15, 1.35), between(rng, 0, math.tau)) * np.float32(between(rng, 1.2, 4))
    centre = np.clip(centre, scene.low + 0.2, scene.high - 0.2)
    centre = centre * np.float32(max(1.0, 0.9 / float(np.linalg.norm(centre))))
    forward = -centre + vector(*(between(rng, -0.6, 0.6) for _ in range(3)))
    right = np.cross(forward, vector(0.01, 1, 0.02))
    up = np.cross(right, forward)
    scale = log_between(rng, 0.3, 1.3)
    halves = pick(rng, ((0.6, 0.6), (0.15, 0.8), (0.5, 0.7), (0.9, 0.9), (0.12, 0.12), (0.8, 0.15)))
    right, up = (
        axis * np.float32(scale * half / np.linalg.norm(axis)) for axis, half in zip((right, up), halves, strict=True)
    )
    colour = black_body_rgb(kelvin) if chance(rng, 0.75) else np.clip(uniforms(rng, 3), 0.05, 1)
    radiance = colour * np.float32(log_between(rng, 1, 30) / (math.prod(halves) * scale**2))
    scene.lamps.append(Lamp(centre, -right, up, radiance, pick(rng, ("panel", "panel", "disc"))))


def add_beams(rng: Rng, scene: EnvironmentScene) -> None:
    """Add girders under the ceiling, and posts."""
    finish = Finish(draw_near_white(rng, 0.2) * np.float32(log_between(rng, 0.05, 0.4)))
    top, depth, middle = float(scene.high[1]), between(rng, 0.3, 0.9), float(scene.low[0] + scene.high[0]) / 2
    first, last = float(scene.low[2]) + 1, float(scene.high[2]) - 1
    for z in np.linspace(first, last, integer_between(rng, 2, 7)).tolist():
        low, high = vector(scene.low[0], top - depth, z - 0.12), vector(scene.high[0], top, z + 0.12)
        scene.boxes.append(Box(low, high, finish))
    for z in np.linspace(first, last, integer_between(rng, 0, 4)).tolist():
        scene.add_box(
            EYE_CLEARANCE_M,
            Box(vector(middle - 0.2, scene.low[1], z - 0.2), vector(middle + 0.2, top, z + 0.2), finish),
        )


def add_doors(rng: Rng, scene: EnvironmentScene, count: int) -> None:
    """Add doors, pictures, boards and cupboards at the walls."""
    for _ in range(count):
        finish, side = (
            _draw_painted_finish(rng, draw_near_white(rng, 0.4) * np.float32(log_between(rng, 0.05, 0.7))),
            pick(rng, WALL_SIDES),
        )
        size, bottom = (between(rng, 0.4, 2), between(rng, 0.3, 1.2), 0.05), between(rng, -0.5, 0.4)
        if chance(rng, 0.4):
            size, bottom = (between(rng, 0.8, 1.2), 2.0, 0.04), float(scene.low[1])
        add_box_at_wall(scene, side, between(rng, 0.1, 0.9), bottom, size, finish)


def add_box_at_wall(
    scene: EnvironmentScene, side: int, share: float, bottom: float, size: tuple[float, float, float], finish: Finish
) -> None:
    """Add a box at a wall.

    Args:
        scene: the room; the box is added to it.
        side: number of the wall.
        share: position of the box's middle, as a share of the wall's width.
        bottom: height of its lower side, m from the eye.
        size: width, height and depth in m.
        finish: the look of its surface.
    """
    axis, across = side // 2, PLANE_AXES[side // 2][0]
    low, high = scene.low.copy(), scene.high.copy()
    middle = float(scene.low[across] + share * (scene.high[across] - scene.low[across]))
    low[across], high[across] = middle - size[0] / 2, middle + size[0] / 2
    low[1], high[1] = bottom, min(bottom + size[1], float(scene.high[1]) - 0.05)
    if side % 2:
        low[axis] = scene.high[axis] - size[2]
    else:
        high[axis] = scene.low[axis] + size[2]
    scene.add_box(EYE_CLEARANCE_M, Box(np.maximum(low, scene.low), np.minimum(high, scene.high), finish))


def add_furniture(rng: Rng, scene: EnvironmentScene, count: int, height: Range, colourful: bool = False) -> None:
    """Add boxes on the floor with heights from the range in m, most of them at the walls."""
    for _ in range(count):
        colour: Field = vector(0.4, 0.3, 0.2) ** np.float32(between(rng, 0.2, 2)) * draw_near_white(rng, 0.2)
        if colourful and chance(rng, 0.5):
            colour = uniforms(rng, 3) ** 2 * np.float32(0.7)
        finish = _draw_painted_finish(rng, colour * np.float32(between(rng, 0.4, 1)))
        size = (log_between(rng, 0.5, 3), log_between(rng, *height), between(rng, 0.4, 1.4))
        if chance(rng, 0.6):
            add_box_at_wall(scene, pick(rng, WALL_SIDES), between(rng, 0.1, 0.9), float(scene.low[1]), size, finish)
            continue
        middle = scene.low + (scene.high - scene.low) * uniforms(rng, 3)
        half = vector(size[0], 0, size[2]) / 2 if chance(rng, 0.5) else vector(size[2], 0, size[0]) / 2
        low, high = np.maximum(middle - half, scene.low), np.minimum(middle + half, scene.high)
        low[1], high[1] = scene.low[1], min(float(scene.low[1]) + size[1], float(scene.high[1]) - 0.1)
        scene.add_box(EYE_CLEARANCE_M, Box(low, high, finish))


def _draw_painted_finish(rng: Rng, colour: Field) -> Finish:
    """Draw a finish about a colour, often of two colours, as drawers, books, machines and pictures have."""
    other = colour * draw_near_white(rng, 0.5) * np.float32(log_between(rng, 0.1, 3))
    kind = pick(rng, ("plain", "plain", "patches", "patches", "stripes"))
    finish = Finish(np.clip(colour, 0.02, 0.85), np.clip(other, 0.02, 0.85), kind, log_between(rng, 0.8, 4))
    return finish._replace(second_colour=None) if kind == "plain" else finish
