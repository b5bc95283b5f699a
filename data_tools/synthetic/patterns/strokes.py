"""Strokes scattered over the periodic tile: fibres, blades, leaves, scratches, the upper ones hiding the lower ones.

Materials give strokes their colours and heights; here are their places alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.random_values import Field, Ids, uniforms


class Strokes(NamedTuple):
    """The strokes on a tile as seen from above.

    Attributes:
        stroke: number [S, S] of the uppermost stroke, -1 if there is none.
        along: position [S, S] along it, 0 .. 1.
        across: position [S, S] across it, -1 .. 1.
        depth: how high it lies [S, S], 0 (lowest) .. 1; 0 where there is none.
        total: number of strokes.
    """

    stroke: Ids
    along: Field
    across: Field
    depth: Field
    total: int

    @property
    def covered(self) -> Field:
        """The coverage [S, S]: 1 where there is a stroke, else 0."""
        return (self.stroke >= 0).astype(np.float32)

    def of_each(self, values: Field) -> Field:
        """Return at each texel [S, S] the value of the uppermost stroke, from values [total]; 0 where there is none."""
        return np.where(self.stroke >= 0, values[self.stroke], 0).astype(np.float32)


def scatter_strokes(
    rng: Rng,
    size: int,
    count: int,
    length: tuple[float, float],
    width: tuple[float, float],
    angle_rad: tuple[float, float],
    curl_rad: float = 0.0,
    pointed: float = 1.0,
) -> Strokes:
    """Scatter strokes evenly over the tile.

    Args:
        rng: random numbers for the strokes.
        size: S, texels along a side of the tile.
        count: number of strokes.
        length: shortest and longest, in tiles.
        width: narrowest and widest, in tiles.
        angle_rad: mean direction and half the spread around it.
        curl_rad: by how much a stroke turns at most over its length.
        pointed: 0 for bars, 1 for blades that end in a point, 2 for leaves that are narrow at both ends.
    """
    draws = uniforms(rng, 6, count)
    # A jittered grid rather than free places: no part of the tile is left bare by chance.
    grid_side = int(np.ceil(np.sqrt(count)))
    order = np.argsort(uniforms(rng, grid_side * grid_side))[:count]
    start_x, start_y = (order % grid_side + draws[0]) / grid_side, (order // grid_side + draws[1]) / grid_side
    lengths = length[0] + (length[1] - length[0]) * draws[2]
    widths = width[0] + (width[1] - width[0]) * draws[3]
    angles = angle_rad[0] + angle_rad[1] * (2 * draws[4] - 1)
    turns = curl_rad * (2 * draws[5] - 1)
    steps = max(2, int(np.ceil(length[1] * size * 1.3)))
    lanes = max(1, int(np.ceil(width[1] * size * 1.5)))
    along: Field = (np.arange(steps, dtype=np.float32) + np.float32(0.5)) / steps
    across: Field = (np.arange(lanes, dtype=np.float32) + np.float32(0.5)) / lanes * 2 - 1
    heading = angles[:, None] + turns[:, None] * along
    pace = lengths[:, None] / steps
    x = start_x[:, None] + np.cumsum(np.cos(heading) * pace, 1)
    y = start_y[:, None] + np.cumsum(np.sin(heading) * pace, 1)
    half_widths = widths[:, None] / 2 * _outline(along, pointed)
    x = x[..., None] - (np.sin(heading) * half_widths)[..., None] * across
    y = y[..., None] + (np.cos(heading) * half_widths)[..., None] * across
    texels = (np.floor(y * size).astype(np.int64) % size) * size + np.floor(x * size).astype(np.int64) % size
    return _find_uppermost(texels, along, across, size)


def _outline(along: Field, pointed: float) -> Field:
    """Return the half width of a stroke over its greatest half width."""
    if pointed == 0:
        return np.ones_like(along)
    blade = np.sqrt(np.clip(1 - along, 0, 1)) * np.minimum(1, along * 8 + np.float32(0.4))
    leaf = np.sin(np.pi * along ** np.float32(0.8))
    result: Field = (blade if pointed <= 1 else leaf).astype(np.float32)
    return result


def _find_uppermost(texels: Ids, along: Field, across: Field, size: int) -> Strokes:
    """Find which of all points [count, steps, lanes] on the strokes is seen at each texel: later strokes lie higher."""
    count, steps, lanes = texels.shape
    last_point = np.full(size * size, -1, np.int64)
    np.maximum.at(last_point, texels.reshape(-1), np.arange(texels.size))
    top_point: Ids = last_point.reshape(size, size)
    stroke = np.where(top_point >= 0, top_point // (steps * lanes), -1)
    depth = np.where(top_point >= 0, (stroke + 1) / count, 0).astype(np.float32)
    return Strokes(stroke, along[top_point // lanes % steps], across[top_point % lanes], depth, count)
