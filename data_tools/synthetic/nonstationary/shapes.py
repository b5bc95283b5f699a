"""Positions on a patch: turned and shifted coordinates, outlines as distances, grids of panels, motifs, letters.

A `place` is :class:`PatchCoordinates`. Distances are in its units, positive inside; times `PatchCoordinates.unit` they
are in texels.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.patterns.fields import texel_centres
from data_tools.synthetic.random_values import Field, Ids, between, chance, integer_between, log_between, pick, uniforms

# Strokes of capital letters and digits over the keys of a number pad, 7 8 9 on top.
_LETTERS = (
    "183,46 9713,46 9713 178621 971,46 971365 17,39,46 28 9314 17,943 713 17593 1739 17931 17964 179643 974631 79,28 "
    "7139 729 71539 73,91 75,95,52 7913 796413 79,31,93,46 746,93 17931,46"
)
_GLYPHS = tuple(_LETTERS.split())


class PatchCoordinates(NamedTuple):
    """The coordinates x and y [S, S] of a patch's texels in a frame of its own, whose unit is `unit` texels long."""

    x: Field
    y: Field
    unit: float

    def moved(self, x: float, y: float, angle_rad: float = 0.0, zoom: float = 1.0) -> PatchCoordinates:
        """Return coordinates whose origin is at (x, y) here, turned by an angle, with units `zoom` times as long."""
        cos, sin = math.cos(angle_rad) / zoom, math.sin(angle_rad) / zoom
        dx, dy = self.x - np.float32(x), self.y - np.float32(y)
        return PatchCoordinates(dx * cos + dy * sin, dy * cos - dx * sin, self.unit * zoom)


def patch_coordinates(size: int) -> PatchCoordinates:
    """Return coordinates from -1 to 1 over the whole patch, y downwards."""
    x, y = texel_centres(size)
    return PatchCoordinates(2 * x - 1, 2 * y - 1, size / 2)


def random_coordinates(
    rng: Rng, size: int, reach: float = 0.6, upright: float = 0.3, zoom: float = 1.0
) -> PatchCoordinates:
    """Draw coordinates whose origin is up to `reach` half sides from the patch's middle, at any angle.

    In the share `upright` of draws, their axes are parallel to the patch's sides.
    """
    angle = pick(rng, (0.0, math.pi / 2, -math.pi / 2, math.pi)) if chance(rng, upright) else between(rng, 0, math.tau)
    return patch_coordinates(size).moved(between(rng, -reach, reach), between(rng, -reach, reach), angle, zoom)


def disc_distance(place: PatchCoordinates, radius: float) -> Field:
    """Return the distance to the rim of a disc about the origin, positive inside."""
    return radius - np.hypot(place.x, place.y)


def box_distance(place: PatchCoordinates, half_width: float, half_height: float, corner: float = 0.0) -> Field:
    """Return the distance to the rim of a rectangle about the origin, positive inside.

    The corners are rounded with the radius `corner`.
    """
    dx, dy = np.abs(place.x) - (half_width - corner), np.abs(place.y) - (half_height - corner)
    return corner - np.hypot(np.maximum(dx, 0), np.maximum(dy, 0)) - np.minimum(np.maximum(dx, dy), 0)


def outline_distance(inside: Field, half_width: float) -> Field:
    """Return the distance to the rim of a band along both sides of an outline, positive inside."""
    return half_width - np.abs(inside)


def segment_distance(place: PatchCoordinates, start: tuple[float, float], end: tuple[float, float]) -> Field:
    """Return the distance to a straight line between two points, >= 0 everywhere."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    px, py = place.x - np.float32(start[0]), place.y - np.float32(start[1])
    along = np.clip((px * dx + py * dy) / (dx * dx + dy * dy), 0, 1)
    return np.hypot(px - along * dx, py - along * dy)


def star_distance(place: PatchCoordinates, points: int, radius: float, depth: float, round_off: float = 0.0) -> Field:
    """Return about the distance to the rim of a star, a polygon or a flower about the origin, positive inside.

    A depth of 0 makes a polygon, up to 0.7 a star of so many points; `round_off` 1 makes a flower.
    """
    angle, reach = np.arctan2(place.y, place.x), np.hypot(place.x, place.y)
    turn = np.abs(((angle * points / math.tau) % 1) - 0.5) * 2  # 0 at a point, 1 between two
    half = math.pi / points
    # The straight edge from a point to the notch beside it.
    px, py = reach * np.cos(turn * half), reach * np.sin(turn * half)
    notch = radius * math.cos(half) * (1 - depth)
    ex, ey = notch * math.cos(half) - radius, notch * math.sin(half)
    straight = ((px - np.float32(radius)) * ey - py * ex) / -math.hypot(ex, ey)
    petal = radius * (1 - depth * (0.5 - 0.5 * np.cos(turn * math.pi))) - reach
    return straight + (petal - straight) * np.float32(round_off)


def motif_distance(rng: Rng, place: PatchCoordinates) -> Field:
    """Draw an ornament within about a unit of the origin, and return the distance to its rim, positive inside."""
    kind = pick(rng, ("rosette", "rosette", "star", "rings", "letter", "letter", "lozenges", "spiral", "cross"))
    if kind == "letter":
        return (
            letter_distance(
                place.moved(0, 0, 0, 0.8), integer_between(rng, 0, len(_GLYPHS) - 1), between(rng, 0.12, 0.3)
            )
            * 0.8
        )
    if kind == "spiral":
        turns, reach = between(rng, 2.0, 3.5), np.hypot(place.x, place.y)
        arm = (reach * turns - np.arctan2(place.y, place.x) / math.tau) % 1
        result: Field = np.minimum((between(rng, 0.2, 0.32) - np.abs(arm - 0.5)) / turns, 1 - reach)
        return result
    if kind == "cross":
        arms = np.maximum(
            box_distance(place, 0.95, between(rng, 0.12, 0.3)), box_distance(place, between(rng, 0.12, 0.3), 0.95)
        )
        return np.maximum(arms, outline_distance(disc_distance(place, 0.6), 0.1)) if chance(rng, 0.6) else arms
    if kind == "lozenges":
        rhombs = [0.5 - np.abs(place.x - np.float32(0.5 * i)) * 1.2 - np.abs(place.y) * 0.7 for i in (-1, 0, 1)]
        result = np.maximum.reduce(rhombs) / 1.4
        return result
    if kind == "rings":
        radius = between(rng, 0.3, 0.6)
        return np.maximum(
            outline_distance(disc_distance(place, 0.85), 0.1),
            outline_distance(disc_distance(place, radius), between(rng, 0.05, 0.18)),
        )
    points, depth = integer_between(rng, 4, 12), between(rng, 0.25, 0.6)
    body = star_distance(place, points, 0.95, depth, float(kind == "rosette"))
    if chance(rng, 0.6):  # a ring let in, and a heart
        radius = between(rng, 0.2, 0.35)
        body = np.maximum(
            np.minimum(body, np.abs(disc_distance(place, radius)) - 0.05), disc_distance(place, radius * 0.6)
        )
    return body


def letter_distance(place: PatchCoordinates, number: int, half_width: float = 0.15) -> Field:
    """Return the distance to the rim of a capital letter within about a unit of the origin, positive inside.

    The letter's strokes are twice `half_width` wide.
    """
    nearest = np.full(place.x.shape, 9, np.float32)
    for line in _GLYPHS[number % len(_GLYPHS)].split(","):
        points = [((int(key) - 1) % 3 * 0.6 - 0.6, 0.9 - (int(key) - 1) // 3 * 0.9) for key in line]
        for start, end in itertools.pairwise(points):
            nearest = np.minimum(nearest, segment_distance(place, start, end))
    return half_width - nearest


def text_distance(
    rng: Rng, place: PatchCoordinates, half_width: float, half_height: float, rows: float, weight: float = 0.15
) -> Field:
    """Draw ragged lines of letters in a box about the origin, and return the distance to their rims, positive inside.

    Args:
        rng: random numbers for letters, spaces and the lengths of lines.
        place: coordinates of the box.
        half_width: half the width of the box.
        half_height: half the height of the box.
        rows: number of lines.
        weight: half the width of strokes, over half the height of letters.
    """
    pitch = 2 * half_height / rows
    row = np.floor((place.y + half_height) / pitch)
    column = np.floor((place.x + half_width) / (pitch * 0.6))
    letter_count = integer_between(rng, 6, 12)
    start = integer_between(rng, 0, len(_GLYPHS) - 1)
    count = max(1, int(2 * half_width / (pitch * 0.6)))
    lines = max(1, int(rows))
    lengths = (count * (1 - between(rng, 0, 0.6) * uniforms(rng, lines))).astype(np.int64)
    letter_numbers = np.where(
        uniforms(rng, lines, count) < 0.85, (uniforms(rng, lines, count) * letter_count).astype(np.int64), -1
    )
    within = (row >= 0) & (row < lines) & (column >= 0) & (column < count)
    row_index, column_index = (
        np.clip(row, 0, lines - 1).astype(np.int64),
        np.clip(column, 0, count - 1).astype(np.int64),
    )
    letter = np.where(within & (column_index < lengths[row_index]), letter_numbers[row_index, column_index], -1)
    scale = pitch * 0.36
    px = (place.x + half_width - (column + 0.5) * (pitch * 0.6)) / scale
    py = (place.y + half_height - (row + 0.5) * pitch) / scale
    inside = np.full(place.x.shape, -1, np.float32)
    for number in range(letter_count):
        shown = letter == number
        inside[shown] = letter_distance(PatchCoordinates(px[shown], py[shown], 1), start + number, weight)
    return inside * np.float32(scale)


class PanelGrid(NamedTuple):
    """A grid of panels in rows.

    Attributes:
        column, row: numbers [S, S] of the panel.
        u, v: coordinates [S, S] from a panel's middle, in the units of its place.
        inside: distance [S, S] to the panel's rim.
        cell: identity [S, S] of the panel, 0 .. total - 1.
        total: number of panels.
    """

    column: Ids
    row: Ids
    u: Field
    v: Field
    inside: Field
    cell: Ids
    total: int


def panel_grid(
    place: PatchCoordinates, width: float, height: float, shift: float = 0.0, corner: float = 0.0
) -> PanelGrid:
    """Return panels of a width and a height all over; a share of the width shifts each row against the row before."""
    row = np.floor(place.y / height).astype(np.int64)
    along = place.x / width + np.float32(shift) * row
    column = np.floor(along).astype(np.int64)
    u = ((along - column - 0.5) * width).astype(np.float32)
    v = ((place.y / height - row - 0.5) * height).astype(np.float32)
    inside = box_distance(PatchCoordinates(u, v, place.unit), width / 2, height / 2, corner)
    column_index, row_index = column - column.min(), row - row.min()
    column_count = int(column_index.max()) + 1
    return PanelGrid(
        column, row, u, v, inside, row_index * column_count + column_index, column_count * (int(row_index.max()) + 1)
    )


def random_panel_grid(
    rng: Rng, place: PatchCoordinates, width: tuple[float, float], aspect: tuple[float, float]
) -> PanelGrid:
    """Draw a grid in one of the common bonds, whose origin is the origin of `place`."""
    panel_width = log_between(rng, *width)
    return panel_grid(place, panel_width, panel_width / log_between(rng, *aspect), pick(rng, (0.0, 0.0, 0.5, 0.33)))
