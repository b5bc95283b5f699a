"""Histogram-preserving blending: noise that has an exemplar's colours and fine structure (Heitz & Neyret 2018).

The exemplar's colours become normal numbers, in which blends of patches keep their distribution, and turn back into
colours at the end. The method is by itself and knows neither networks nor tasks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Generator, Tensor

PATCH_SHARE = 1 / 4  # longest edge of a triangle over the exemplar's shorter side; a patch is two edges wide
STRIP_ROWS = 512


class ColourDistribution(NamedTuple):
    """The distribution of a picture's colours, as that of three numbers that are not correlated.

    Attributes:
        mean: the mean colour, [3].
        axes: the principal axes of colours, one a column, [3, 3].
        sorted_values: the coordinates of all pixels along each axis, [3, N] in ascending order.
    """

    mean: Tensor
    axes: Tensor
    sorted_values: Tensor

    @classmethod
    def of(cls, picture: Tensor) -> ColourDistribution:
        """Return the distribution of the colours of a picture [3, H, W]."""
        colours = picture.flatten(1).double()
        mean = colours.mean(1)
        centred = colours - mean[:, None]
        axes = torch.linalg.eigh(centred @ centred.T)[1]
        return cls(mean, axes, (axes.T @ centred).sort(1)[0])

    def to_normal(self, picture: Tensor) -> Tensor:
        """Map pixels [3, h, w] of the distribution's picture to normal numbers [3, h, w], by ranks along each axis.

        Equal values share their middle rank, so that flat places stay flat.
        """
        values = self.axes.T @ (picture.flatten(1).double() - self.mean[:, None])
        ascending, order = values.sort(1)  # values in order are found several times as fast
        below, up_to = (torch.searchsorted(self.sorted_values, ascending, right=right) for right in (False, True))
        # in double precision, as single precision cannot tell the last of 2^24 ranks from 1
        shares = (below + up_to).double() / (2 * self.sorted_values.shape[1])
        normal = torch.empty_like(values).scatter_(1, order, torch.special.ndtri(shares)).float()
        result: Tensor = normal.unflatten(1, picture.shape[1:])
        return result

    def to_colours(self, normal: Tensor) -> Tensor:
        """Map normal numbers [3, H, W] to colours [3, H, W], the inverse of :meth:`to_normal`."""
        count = self.sorted_values.shape[1]
        ranks = (torch.special.ndtr(normal.flatten(1).double()) * count - 0.5).clamp(0, count - 1)
        below = ranks.floor().long().clamp_max(max(0, count - 2))
        above = (below + 1).clamp_max(count - 1)
        values = torch.lerp(self.sorted_values.gather(1, below), self.sorted_values.gather(1, above), ranks - below)
        colours: Tensor = (self.axes @ values + self.mean[:, None]).to(normal).unflatten(1, normal.shape[1:])
        return colours


def blend_tile(exemplar: Tensor, size: tuple[int, int], rng: Generator, *, strip_rows: int = STRIP_ROWS) -> Tensor:
    """Blend a picture that tiles from patches of an exemplar.

    A triangle grid covers the picture and continues at opposite edges. Each vertex has a patch of the exemplar at a
    random place; at each pixel the patches of three vertices are blended by its barycentric coordinates.

    Args:
        exemplar: the source of all patches, [3, H, W], sRGB in [0, 1], evenly lit.
        size: the height and width of the picture in px.
        rng: chooses the places of patches.
        strip_rows: the rows of the picture that are blended at a time, which bound the memory it takes.

    Returns:
        The picture, [3, *size], sRGB in [0, 1].
    """
    distribution = ColourDistribution.of(exemplar)
    normal = distribution.to_normal(exemplar)
    mean = normal.mean((1, 2), keepdim=True)
    edge = PATCH_SHARE * min(exemplar.shape[1:])
    # an even number of rows, as each row of vertices is half an edge further to the right than the one before
    rows, columns = 2 * math.ceil(size[0] / (math.sqrt(3) * edge)), math.ceil(size[1] / edge)
    steps = size[0] / rows, size[1] / columns  # distances of vertices in px, at most those of an equilateral triangle
    margins = [math.ceil(step) + 1 for step in steps]  # px from the centre of a patch to its furthest px
    centres = [
        torch.randint(margin, side - margin, (rows, columns), generator=rng)
        for margin, side in zip(margins, exemplar.shape[1:], strict=True)
    ]
    x = torch.arange(size[1])[None]
    strips = []
    for y_strip in torch.arange(size[0]).split(strip_rows):
        y = y_strip[:, None]
        blend, squared_weights = torch.zeros(3, len(y), size[1]), torch.zeros(len(y), size[1])
        for row, column, weight in find_triangle(y / steps[0], x / steps[1]):
            # the patch of a vertex beyond an edge is the one of the vertex that continues it at the opposite edge
            vertex = row % rows, (column + row.div(rows, rounding_mode="floor") * (rows // 2)) % columns
            # whole numbers, so that a vertex and its continuation lie exactly a side of the picture apart
            patch_y = y - row * size[0] // rows + centres[0][vertex]
            patch_x = x - (2 * column + row) * size[1] // (2 * columns) + centres[1][vertex]
            blend += weight * (normal[:, patch_y, patch_x] - mean)
            squared_weights += weight**2
        strips.append(distribution.to_colours(blend / squared_weights.sqrt() + mean))
    return torch.cat(strips, 1).clamp(0, 1)


def find_triangle(y: Tensor, x: Tensor) -> list[tuple[Tensor, Tensor, Tensor]]:
    """Find the triangle of a grid that holds each point, [h, w].

    Vertex (i, j) of the grid lies at y = i, x = j + i / 2.

    Args:
        y: the points' y in distances of rows, [h, 1].
        x: the points' x in lengths of edges, [1, w].

    Returns:
        The row i, the column j and the barycentric coordinate, which is 1 at the vertex, of three vertices.
    """
    y, x = torch.broadcast_tensors(y, x)
    x = x - y / 2
    row, column = y.floor().long(), x.floor().long()
    down, right = y - row, x - column
    upper = (down + right) < 1  # the triangle that has the vertex (row, column)
    return [
        (row + (~upper).long(), column + (~upper).long(), (1 - down - right).abs()),
        (row + 1, column, torch.where(upper, down, 1 - right)),
        (row, column + 1, torch.where(upper, right, 1 - down)),
    ]
