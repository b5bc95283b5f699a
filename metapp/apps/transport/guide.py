"""q(directions | film) as a table, from which guided paths take their first direction at the cost of a look-up."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from metapp.apps.transport import spline
from metapp.apps.transport.flow import Flow
from metapp.learning.task import Params

GUIDE_PLACES, GUIDE_CELLS = 32, 32  # along a side of the film, and of the directions of each place
DENSITY_POWER = 0.5


class GuideTable(NamedTuple):
    """A density that is constant in every cell of a grid over the film and the first direction.

    It is a density of its own, whatever flow it was made from: its samples have its density exactly.

    Attributes:
        masses: of each cell, [G * G, D * D]; the rows, film places from the top left, sum to 1.
        ends: their running sum over all cells, float64 [G * G * D * D], so that the rows' totals are whole numbers.
    """

    masses: Tensor
    ends: Tensor

    def sample(self, film: Tensor) -> tuple[Tensor, Tensor]:
        """Directions [N, 2] at places [N, 2] on the film, and their density [N], by torch's own random numbers."""
        row = self._row(film)
        within = self.masses.shape[1]
        uniform = torch.rand(len(film), 3, dtype=torch.float64, device=film.device)
        index = torch.searchsorted(self.ends, row + uniform[:, 0], right=True)
        index = torch.minimum(torch.maximum(index, row * within), row * within + within - 1)
        return self._inside(index % within, uniform[:, 1:]), self._densities(index)

    def density(self, film: Tensor, directions: Tensor) -> Tensor:
        """Of directions [N, 2] at places [N, 2] on the film, [N]."""
        side = round(self.masses.shape[1] ** 0.5)
        cell = (directions * side).long().clamp(0, side - 1)
        return self._densities(self._row(film) * side * side + cell[:, 0] * side + cell[:, 1])

    def _row(self, film: Tensor) -> Tensor:
        side = round(self.masses.shape[0] ** 0.5)
        cell = (film * side).long().clamp(0, side - 1)
        result: Tensor = cell[:, 1] * side + cell[:, 0]
        return result

    def _inside(self, cell: Tensor, uniform: Tensor) -> Tensor:
        side = round(self.masses.shape[1] ** 0.5)
        corner = torch.stack([cell // side, cell % side], 1)
        result: Tensor = ((corner + uniform) / side).float().clamp_max(spline.BELOW_ONE)
        return result

    def _densities(self, index: Tensor) -> Tensor:
        return self.masses.flatten()[index] * self.masses.shape[1]


@torch.no_grad()
def make_guide_table(
    flow: Flow, theta: Params, places: int = GUIDE_PLACES, cells: int = GUIDE_CELLS, power: float = DENSITY_POWER
) -> GuideTable:
    """A power of the first direction's density, looked up at the middle of each place on the film.

    Args:
        flow: the network.
        theta: its parameters for one task, no task axis.
        places: rows and columns of places on the film.
        cells: rows and columns of cells of directions; the rows, of the first coordinate, hold exactly the flow's mass,
            and share it as the flow does at their middle.
        power: of the density; 1 is the flow's own. The best density for a mean goes with the root of the mean square of
            the radiance of paths. Most are black and the others about equal, so that the mean square
            goes with the mean, which the flow has learned.
    """
    one = {key: value[None] for key, value in theta.items()}
    middles = (torch.arange(places, device=theta["z"].device) + 0.5) / places
    across = (torch.arange(cells, device=theta["z"].device) + 0.5) / cells
    rows = []
    for y in middles:
        trunk = flow.trunk(one, middles[None], y.expand(1, places))
        first = spline.cell_masses(
            flow.numbers(one, 0, trunk, middles.new_empty(1, 0, places)), cells
        )  # [1, cells, places]
        before = across.repeat(places)[None, None]
        second = spline.cell_masses(flow.numbers(one, 1, trunk.repeat_interleave(cells, 2), before), cells)
        rows.append(first[0].T[..., None] * second[0].T.reshape(places, cells, cells))
    return _table(torch.cat(rows).flatten(1) ** power)


def _table(masses: Tensor) -> GuideTable:
    exact = masses.double()
    exact = exact / exact.sum(1, keepdim=True)
    ends = exact.cumsum(1) + torch.arange(len(exact), device=exact.device)[:, None]
    return GuideTable(exact.float(), ends.flatten())
