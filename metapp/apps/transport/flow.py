"""A normalizing flow on the unit cube of primary samples: q(film) q(directions | film), with a code in every place."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import pad, silu

from metapp.apps.transport import spline
from metapp.learning.random_tensors import draw_normal
from metapp.learning.task import Params

DIRECTION_COORDINATES = 2  # coordinates after the film's two: those of the direction at the first surface that scatters


class Flow(NamedTuple):
    """A chain of rational-quadratic splines, one a coordinate, each conditioned on the coordinates before it.

    The film's x has a spline of its own; the numbers of its y's are read, linearly, off a table with x. Those of the
    directions' come from a network of two layers that sees a code at the place on the film, interpolated on a grid as
    in `LocalField`, and the directions' coordinates before, one-blob encoded (Mueller et al. 2019). Coupling layers
    that each move one coordinate are such a chain; it needs no more of them, as splines take any shape.

    Attributes:
        rows, columns: cells of the code's grid on the film.
        code: length of the code in a cell.
        hidden: units of a layer.
        bins: of a direction's spline.
        film_bins: of the film's splines.
        blobs: of the encoding of a coordinate.
        gain, film_gain: of the code and of the film's numbers; a step of a rate moves these so many times as far as a
            weight.
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
        """Random parameters of `count` flows, each tensor [count, ...]; all are the identity."""

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
        """Of the film and of the directions there.

        Args:
            theta: parameters of T flows, as of `init`.
            points: in [0, 1), [T, 2 + DIRECTIONS, N].

        Returns:
            log q(film) and log q(directions | film), [T, N] each.
        """
        x, y = points[:, 0], points[:, 1]
        of_x, of_y = self.film(theta, x)
        film = spline.log_density(of_x, x) + spline.log_density(of_y, y)
        trunk = self.trunk(theta, x, y)
        directions = torch.zeros_like(film)
        for i in range(DIRECTION_COORDINATES):
            numbers = self.numbers(theta, i, trunk, points[:, 2 : 2 + i])
            directions = directions + spline.log_density(numbers, points[:, 2 + i])
        return film, directions

    def film(self, theta: Params, x: Tensor) -> tuple[Tensor, Tensor]:
        """The numbers of the splines of x, [T, 3 K + 1, 1], and of y at x [T, N], [T, 3 K + 1, N].

        Those of y are read off a table [T, 3, K, K] of widths, masses and bends, y down and x across; at the lower edge
        of the film nothing is bent.
        """
        table = self.film_gain * pad(theta["film.y"].flatten(1, 2), (0, 0, 0, 1))
        return self.film_gain * theta["film.x"][..., None], table @ blobs(x, self.film_bins)

    def trunk(self, theta: Params, x: Tensor, y: Tensor) -> Tensor:
        """Features of a place on the film, for all directions' splines: [T, hidden, N]."""
        code = self.gain * interpolate_grid(theta["z"], x, y)
        return silu(torch.baddbmm(theta["trunk.shift"][..., None], theta["trunk.kernel"], code))

    def numbers(self, theta: Params, i: int, trunk: Tensor, before: Tensor) -> Tensor:
        """The numbers [T, 3 K + 1, N] of the spline of direction i, given those before it, [T, i, N]."""
        x = torch.baddbmm(theta[f"mix{i}.shift"][..., None], theta[f"mix{i}.kernel"], trunk)
        if i:
            encoded = torch.cat([blobs(before[:, k], self.blobs) for k in range(i)], 1)
            x = torch.baddbmm(x, theta[f"mix{i}.blobs"], encoded)
        return torch.baddbmm(theta[f"out{i}.shift"][..., None], theta[f"out{i}.kernel"], silu(x))


def blobs(x: Tensor, count: int) -> Tensor:
    """One-blob encoding of x [T, N] in [0, 1]: how near each of `count` evenly spaced centres is, [T, count, N].

    A blob is a hat that reaches the next centre; all hats sum to 1.
    """
    centres = torch.arange(count, dtype=x.dtype, device=x.device)[:, None]
    place = (x * count - 0.5).clamp(0, count - 1)
    return (1 - (place[:, None] - centres).abs()).clamp_min(0)


def interpolate_grid(grid: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Interpolate a grid [T, C, rows, columns] over the unit square at places [T, N] each, bilinearly: [T, C, N]."""
    rows, columns = grid.shape[-2:]
    flat = grid.flatten(2)
    down, across = (y * rows - 0.5).clamp(0, rows - 1), (x * columns - 0.5).clamp(0, columns - 1)
    row, column = down.long().clamp_max(rows - 2), across.long().clamp_max(columns - 2)
    down, across = down - row, across - column
    total = torch.zeros(())
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        weight = (down if i else 1 - down) * (across if j else 1 - across)
        index = ((row + i) * columns + column + j)[:, None].expand(-1, flat.shape[1], -1)
        total = total + weight[:, None] * flat.gather(2, index)
    return total
