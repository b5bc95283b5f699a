"""Positions on a patch: turned and shifted places, outlines as distances, grids of panels, motifs, letters.

Distances are in the units of their place, positive inside; times `Place.unit` they are in texels.
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
    """Coordinates x and y [S, S], whose unit is so many texels long."""

    x: Field
    y: Field
    unit: float

    def moved(self, x: float, y: float, angle_rad: float = 0.0, zoom: float = 1.0) -> PatchCoordinates:
        """The place whose origin lies at (x, y) here, turned by an angle, its unit `zoom` of the units here."""
        cos, sin = math.cos(angle_rad) / zoom, math.sin(angle_rad) / zoom
        dx, dy = self.x - np.float32(x), self.y - np.float32(y)
        return PatchCoordinates(dx * cos + dy * sin, dy * cos - dx * sin, self.unit * zoom)


def patch_coordinates(size: int) -> PatchCoordinates:
    """The patch itself: from -1 to 1, y downwards."""
    x, y = texel_centres(size)
    return PatchCoordinates(2 * x - 1, 2 * y - 1, size / 2)


def random_coordinates(
    rng: Rng, size: int, reach: float = 0.6, upright: float = 0.3, zoom: float = 1.0
) -> PatchCoordinates:
    """A place about the patch's middle or up to `reach` half sides from it, at any angle but in `upright` of draws."""
    angle = pick(rng, (0.0, math.pi / 2, -math.pi / 2, math.pi)) if chance(rng, upright) else between(rng, 0, math.tau)
    return patch_coordinates(size).moved(between(rng, -reach, reach), between(rng, -reach, reach), angle, zoom)


def disc_distance(place: PatchCoordinates, radius: float) -> Field:
    """A disc about the origin."""
    return radius - np.hypot(place.x, place.y)


def box_distance(place: PatchCoordinates, half_width: float, half_height: float, corner: float = 0.0) -> Field:
    """A rectangle about the origin, its corners rounded."""
    dx, dy = np.abs(place.x) - (half_width - corner), np.abs(place.y) - (half_height - corner)
    return corner - np.hypot(np.maximum(dx, 0), np.maximum(dy, 0)) - np.minimum(np.maximum(dx, dy), 0)


def outline_distance(inside: Field, half_width: float) -> Field:
    """A band on both sides of an outline."""
    return half_width - np.abs(inside)


def segment_distance(place: PatchCoordinates, start: tuple[float, float], end: tuple[float, float]) -> Field:
    """Distance to a straight line between two points, >= 0 everywhere."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    px, py = place.x - np.float32(start[0]), place.y - np.float32(start[1])
    along = np.clip((px * dx + py * dy) / (dx * dx + dy * dy), 0, 1)
    return np.hypot(px - along * dx, py - along * dy)


def star_distance(place: PatchCoordinates, points: int, radius: float, depth: float, round_off: float = 0.0) -> Field:
    """A star (depth up to 0.7), a polygon (depth 0) or a flower (round_off 1) of so many points; about its distance."""
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
    """One of many ornaments within about a unit of the origin: distance, positive inside."""
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
    """A capital letter within about a unit of the origin, its lines so wide."""
    nearest = np.full(place.x.shape, 9, np.float32)
    for line in _GLYPHS[number % len(_GLYPHS)].split(","):
        points = [((int(key) - 1) % 3 * 0.6 - 0.6, 0.9 - (int(key) - 1) // 3 * 0.9) for key in line]
        for start, end in itertools.pairwise(points):
            nearest = np.minimum(nearest, segment_distance(place, start, end))
    return half_width - nearest


def text_distance(
    rng: Rng, place: PatchCoordinates, half_width: float, half_height: float, rows: float, weight: float = 0.15
) -> Field:
    """Ragged lines of letters in a box about the origin.

    Args:
        rng: of letters, spaces and the lengths of lines.
        place: its position.
        half_width: of the box.
        half_height: of the box.
        rows: how many lines.
        weight: half the width of strokes, over half the height of letters.
    """
    pitch = 2 * half_height / rows
    row = np.floor((place.y + half_height) / pitch)
    column = np.floor((place.x + half_width) / (pitch * 0.6))
    kinds = integer_between(rng, 6, 12)
    start = integer_between(rng, 0, len(_GLYPHS) - 1)
    count = max(1, int(2 * half_width / (pitch * 0.6)))
    lines = max(1, int(rows))
    lengths = (count * (1 - between(rng, 0, 0.6) * uniforms(rng, lines))).astype(np.int64)
    drawn = np.where(uniforms(rng, lines, count) < 0.85, (uniforms(rng, lines, count) * kinds).astype(np.int64), -1)
    within = (row >= 0) & (row < lines) & (column >= 0) & (column < count)
    r, c = np.clip(row, 0, lines - 1).astype(np.int64), np.clip(column, 0, count - 1).astype(np.int64)
    which = np.where(within & (c < lengths[r]), drawn[r, c], -1)
    scale = pitch * 0.36
    px = (place.x + half_width - (column + 0.5) * (pitch * 0.6)) / scale
    py = (place.y + half_height - (row + 0.5) * pitch) / scale
    inside = np.full(place.x.shape, -1, np.float32)
    for number in range(kinds):
        here = which == number
        inside[here] = letter_distance(PatchCoordinates(px[here], py[here], 1), start + number, weight)
    return inside * np.float32(scale)


class PanelGrid(NamedTuple):
    """Panels in rows.

    Attributes:
        column, row: numbers [S, S].
        u, v: from a panel's middle [S, S], in the units of its place.
        inside: distance [S, S] to the panel's rim.
        cell: identity [S, S], 0 .. total - 1.
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
    """Panels of this width and height all over, each row shifted against the one before by a share of the width."""
    row = np.floor(place.y / height).astype(np.int64)
    along = place.x / width + np.float32(shift) * row
    column = np.floor(along).astype(np.int64)
    u = ((along - column - 0.5) * width).astype(np.float32)
    v = ((place.y / height - row - 0.5) * height).astype(np.float32)
    inside = box_distance(PatchCoordinates(u, v, place.unit), width / 2, height / 2, corner)
    i, j = column - column.min(), row - row.min()
    wide = int(i.max()) + 1
    return PanelGrid(column, row, u, v, inside, j * wide + i, wide * (int(j.max()) + 1))


def random_panel_grid(
    rng: Rng, place: PatchCoordinates, width: tuple[float, float], aspect: tuple[float, float]
) -> PanelGrid:
    """A grid in one of the common bonds, its origin anywhere."""
    wide = log_between(rng, *width)
    return panel_grid(place, wide, wide / log_between(rng, *aspect), pick(rng, (0.0, 0.0, 0.5, 0.33)))
