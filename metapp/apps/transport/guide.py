"""The density q(directions | film) as a table, from which guided paths take their first direction by a look-up.

A flow is too slow to be asked by each path. The table is made once for a fit; tracers know it by its two methods.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from metapp.apps.transport import spline
from metapp.apps.transport.flow import Flow
from metapp.learning.task import Params, add_task_axis

GUIDE_PLACES, GUIDE_CELLS = 32, 32  # places along a side of the film, and cells along a side of each one's directions
DENSITY_POWER = 0.5  # the power of the flow's density that guides paths: see `make_guide_table`


class GuideTable(NamedTuple):
    """A density that is constant in every cell of a grid over the film and the first direction.

    It is a density of its own, whatever flow it was made from: its samples have its density exactly.

    Attributes:
        masses: masses of the cells, [G * G, D * D]; rows are places on the film from the top left, and sum to 1.
        ends: running sum of the masses over all cells, float64 [G * G * D * D], whose rows end at whole numbers.
    """

    masses: Tensor
    ends: Tensor

    def sample(self, film: Tensor) -> tuple[Tensor, Tensor]:
        """Draw a direction [N, 2] at each place [N, 2] on the film, and return its density [N], too.

        Random numbers are torch's own, which its global seed sets.
        """
        rows = self._find_rows(film)
        cells_per_row = self.masses.shape[1]
        draws = torch.rand(len(film), 3, dtype=torch.float64, device=film.device)
        index = torch.searchsorted(self.ends, rows + draws[:, 0], right=True)
        index = torch.minimum(torch.maximum(index, rows * cells_per_row), rows * cells_per_row + cells_per_row - 1)
        return self._place_in_cells(index % cells_per_row, draws[:, 1:]), self._look_up(index)

    def density(self, film: Tensor, directions: Tensor) -> Tensor:
        """Return the densities [N] of directions [N, 2] at places [N, 2] on the film."""
        side = round(self.masses.shape[1] ** 0.5)
        cell = (directions * side).long().clamp(0, side - 1)
        return self._look_up(self._find_rows(film) * side * side + cell[:, 0] * side + cell[:, 1])

    def _find_rows(self, film: Tensor) -> Tensor:
        """Return the indices [N] of the rows of places [N, 2] on the film."""
        side = round(self.masses.shape[0] ** 0.5)
        cell = (film * side).long().clamp(0, side - 1)
        result: Tensor = cell[:, 1] * side + cell[:, 0]
        return result

    def _place_in_cells(self, cell: Tensor, uniform: Tensor) -> Tensor:
        """Return directions [N, 2] in cells [N] of a row; numbers [N, 2] in [0, 1) say the position in the cell."""
        side = round(self.masses.shape[1] ** 0.5)
        corner = torch.stack([cell // side, cell % side], 1)
        result: Tensor = ((corner + uniform) / side).float().clamp_max(spline.BELOW_ONE)
        return result

    def _look_up(self, index: Tensor) -> Tensor:
        """Return the densities [N] of cells, by their indices [N] among all."""
        return self.masses.flatten()[index] * self.masses.shape[1]


@torch.no_grad()
def make_guide_table(
    flow: Flow, theta: Params, places: int = GUIDE_PLACES, cells: int = GUIDE_CELLS, power: float = DENSITY_POWER
) -> GuideTable:
    """Make a table of a power of the first direction's density, at the middle of each place on the film.

    Args:
        flow: the network.
        theta: its parameters for one task, without a task axis.
        places: rows and columns of places on the film.
        cells: rows and columns of cells of directions. Rows, of the first coordinate, hold exactly the flow's mass if
            `power` is 1, and share it among their cells as the flow does at their middle.
        power: the power of the density; 1 for the flow's own. The best density for a mean goes with the root of the
            mean square of the radiance of paths. Most paths are black and the others about equal, so that the mean
            square goes with the mean, which the flow has learned.
    """
    batched = add_task_axis(theta)
    middles = (torch.arange(places, device=theta["z"].device) + 0.5) / places
    cell_middles = (torch.arange(cells, device=theta["z"].device) + 0.5) / cells
    rows = []
    for y in middles:
        features = flow.place_features(batched, middles[None], y.expand(1, places))
        nothing_before = middles.new_empty(1, 0, places)
        # [1, cells, places]
        first = spline.cell_masses(flow.direction_numbers(batched, 0, features, nothing_before), cells)
        first_coordinate = cell_middles.repeat(places)[None, None]
        second_numbers = flow.direction_numbers(batched, 1, features.repeat_interleave(cells, 2), first_coordinate)
        second = spline.cell_masses(second_numbers, cells)
        rows.append(first[0].T[..., None] * second[0].T.reshape(places, cells, cells))
    return _normalise_rows(torch.cat(rows).flatten(1) ** power)


def _normalise_rows(masses: Tensor) -> GuideTable:
    """Make a table of masses [G * G, D * D] whose rows need not sum to 1."""
    exact = masses.double()
    exact = exact / exact.sum(1, keepdim=True)
    ends = exact.cumsum(1) + torch.arange(len(exact), device=exact.device)[:, None]
    return GuideTable(exact.float(), ends.flatten())
