"""A normalizing flow on the unit cube of primary samples: q(film) q(directions | film), with a code in every place.

The flow is fitted to samples by their likelihood. Neither scenes nor how a direction is made of its coordinates are
known here.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import pad, silu

from metapp.apps.transport import spline
from metapp.learning.random_tensors import draw_normal
from metapp.learning.task import Params

DIRECTION_COORDINATES = 2  # after the film's two, the coordinates of the direction at the first surface that scatters


class Flow(NamedTuple):
    """A chain of rational-quadratic splines, one a coordinate, each conditioned on the coordinates before it.

    The film's x has a spline of its own; the numbers of its y's spline are read off a table at x, linearly
    interpolated. The numbers of the directions' splines come from a network of two layers, which reads a code at the
    place on the film, interpolated on a grid as in `LocalField`, and the coordinates of the direction so far, one-blob
    encoded (Mueller et al. 2019). Coupling layers that each move one coordinate are such a chain; it needs no more of
    them, as splines take any shape.

    Attributes:
        rows, columns: cells of the code's grid on the film.
        code: length of the code in a cell.
        hidden: units of a layer.
        bins: bins of a direction's spline.
        film_bins: bins of the film's splines.
        blobs: blobs that encode a coordinate.
        gain, film_gain: factors of the code and of the film's numbers; a step of a rate moves these so many times as
            far as a weight.
    """

    rows: int = 16
    columns: int = 16
    code: int = 16
    hidden: int = 48
    bins: int = 12
    film_bins: int = 32
    blobs: int = 24
    gain: float = 10.0
    film_gain: float = 6.0

    def init(self, rng: Generator, count: int) -> Params:
        """Draw random parameters of `count` flows, each tensor [count, ...]; all flows are the identity."""

        def zeros(*shape: int) -> Tensor:
            return torch.zeros(count, *shape, device=rng.device)

        theta = {
            "z": draw_normal(rng, count, self.code, self.rows, self.columns) * (0.1 / self.gain),
            "film.x": zeros(spline.count_numbers(self.film_bins)),
            "film.y": zeros(3, self.film_bins, self.film_bins),
            "trunk.kernel": draw_normal(rng, count, self.hidden, self.code) * math.sqrt(2 / self.code),
            "trunk.shift": zeros(self.hidden),
        }
        for i in range(DIRECTION_COORDINATES):
            theta[f"mix{i}.kernel"] = draw_normal(rng, count, self.hidden, self.hidden) * math.sqrt(2 / self.hidden)
            if i:
                theta[f"mix{i}.blobs"] = draw_normal(rng, count, self.hidden, i * self.blobs)
            theta[f"mix{i}.shift"] = zeros(self.hidden)
            theta[f"out{i}.kernel"] = zeros(spline.count_numbers(self.bins), self.hidden)
            theta[f"out{i}.shift"] = zeros(spline.count_numbers(self.bins))
        return theta

    def log_density(self, theta: Params, points: Tensor) -> tuple[Tensor, Tensor]:
        """Return the log densities of the film's and of the directions' coordinates.

        Args:
            theta: parameters of T flows.
            points: primary samples in [0, 1), [T, 2 + DIRECTION_COORDINATES, N].

        Returns:
            log q(film) and log q(directions | film), [T, N] each.
        """
        x, y = points[:, 0], points[:, 1]
        x_numbers, y_numbers = self.film_numbers(theta, x)
        film = spline.log_density(x_numbers, x) + spline.log_density(y_numbers, y)
        features = self.place_features(theta, x, y)
        directions = torch.zeros_like(film)
        for i in range(DIRECTION_COORDINATES):
            numbers = self.direction_numbers(theta, i, features, points[:, 2 : 2 + i])
            directions = directions + spline.log_density(numbers, points[:, 2 + i])
        return film, directions

    def film_numbers(self, theta: Params, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return the numbers of the splines of the film's x, [T, 3 K + 1, 1], and of its y, [T, 3 K + 1, N].

        The numbers of y are read off a table [T, 3, K, K] of widths, masses and bends, y down and x across. The last
        bend, at the lower edge of the film, is 0.

        Args:
            theta: parameters of T flows.
            x: the film's x in [0, 1), [T, N], at which the table is read.
        """
        table = self.film_gain * pad(theta["film.y"].flatten(1, 2), (0, 0, 0, 1))
        return self.film_gain * theta["film.x"][..., None], table @ encode_blobs(x, self.film_bins)

    def place_features(self, theta: Params, x: Tensor, y: Tensor) -> Tensor:
        """Return features of places on the film, [T, hidden, N], from which all directions' splines are made.

        Args:
            theta: parameters of T flows.
            x: the film's x in [0, 1), [T, N].
            y: the film's y, likewise.
        """
        code = self.gain * interpolate_grid(theta["z"], x, y)
        return silu(torch.baddbmm(theta["trunk.shift"][..., None], theta["trunk.kernel"], code))

    def direction_numbers(self, theta: Params, i: int, features: Tensor, before: Tensor) -> Tensor:
        """Return the numbers of the spline of one of the directions' coordinates, [T, 3 K + 1, N].

        Args:
            theta: parameters of T flows.
            i: the coordinate.
            features: features of places on the film, [T, hidden, N].
            before: the coordinates before it, [T, i, N].
        """
        hidden = torch.baddbmm(theta[f"mix{i}.shift"][..., None], theta[f"mix{i}.kernel"], features)
        if i:
            encoded = torch.cat([encode_blobs(before[:, k], self.blobs) for k in range(i)], 1)
            hidden = torch.baddbmm(hidden, theta[f"mix{i}.blobs"], encoded)
        return torch.baddbmm(theta[f"out{i}.shift"][..., None], theta[f"out{i}.kernel"], silu(hidden))


def encode_blobs(x: Tensor, count: int) -> Tensor:
    """Encode numbers by how near each of `count` evenly spaced centres is (one-blob encoding), [T, count, N].

    A blob is a hat that reaches the next centre; all hats sum to 1.

    Args:
        x: numbers in [0, 1], [T, N].
        count: number of blobs.
    """
    centres = torch.arange(count, dtype=x.dtype, device=x.device)[:, None]
    place = (x * count - 0.5).clamp(0, count - 1)
    return (1 - (place[:, None] - centres).abs()).clamp_min(0)


def interpolate_grid(grid: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Interpolate a grid over the unit square bilinearly, [T, C, N].

    Args:
        grid: values in the middle of cells, [T, C, rows, columns].
        x: places from left to right in [0, 1], [T, N].
        y: places from top to bottom, likewise.
    """
    rows, columns = grid.shape[-2:]
    cells = grid.flatten(2)
    down, across = (y * rows - 0.5).clamp(0, rows - 1), (x * columns - 0.5).clamp(0, columns - 1)
    row, column = down.long().clamp_max(rows - 2), across.long().clamp_max(columns - 2)
    down, across = down - row, across - column
    values = torch.zeros(())
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        weight = (down if i else 1 - down) * (across if j else 1 - across)
        index = ((row + i) * columns + column + j)[:, None].expand(-1, cells.shape[1], -1)
        values = values + weight[:, None] * cells.gather(2, index)
    return values
