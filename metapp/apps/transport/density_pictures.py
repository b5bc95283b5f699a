"""Pictures of the densities of light paths: of samples, as histograms, and of fitted flows.

Both are drawn by one function, so that they can be compared by eye. No scene is rendered here.
"""

from __future__ import annotations

import torch
from torch import Tensor

from metapp.appearance.colour import srgb_to_linear, tone_map
from metapp.apps.transport.flow import DIRECTION_COORDINATES, Flow
from metapp.apps.transport.guide import make_guide_table
from metapp.learning.task import Params, add_task_axis

# cells along a side of the film, parts along it, and cells along a side of each part's directions
FILM_CELLS, FILM_PARTS, DIRECTION_CELLS = 32, 4, 16
PART_PX = 32  # side of a part in a picture


def draw_sample_histograms(samples: Tensor, scene: Tensor | None = None) -> Tensor:
    """Draw histograms of samples, as :func:`draw_densities` draws densities.

    Args:
        samples: primary samples [N, 4 or more] in [0, 1).
        scene: a linear picture of the scene, [3, 32 or 64, as many], to be shown in place of the film's histogram.
    """
    film, parts, cells = ((samples * n).long().clamp_max(n - 1) for n in (FILM_CELLS, FILM_PARTS, DIRECTION_CELLS))
    film_histogram = torch.bincount(film[:, 1] * FILM_CELLS + film[:, 0], minlength=FILM_CELLS**2).float()
    film_histogram = film_histogram.reshape(1, FILM_CELLS, FILM_CELLS)
    index = ((parts[:, 1] * FILM_PARTS + parts[:, 0]) * DIRECTION_CELLS + cells[:, 2]) * DIRECTION_CELLS + cells[:, 3]
    direction_histogram = torch.bincount(index, minlength=(FILM_PARTS * DIRECTION_CELLS) ** 2).float()
    direction_histogram = direction_histogram.reshape(FILM_PARTS, FILM_PARTS, DIRECTION_CELLS, DIRECTION_CELLS)
    return draw_densities(film_histogram if scene is None else scene, direction_histogram)


@torch.no_grad()
def draw_flow_density(flow: Flow, theta: Params, scene: Tensor | None = None) -> Tensor:
    """Draw the density of a fit, as :func:`draw_densities` draws densities.

    Args:
        flow: the network.
        theta: its parameters for one task, without a task axis.
        scene: a linear picture of the scene, [3, 32 or 64, as many], to be shown in place of the film's density.
    """
    middles = (torch.arange(FILM_CELLS) + 0.5) / FILM_CELLS
    y, x = (coordinates.flatten() for coordinates in torch.meshgrid(middles, middles, indexing="ij"))
    points = torch.stack([x, y, *[torch.full_like(x, 0.5)] * DIRECTION_COORDINATES])[None]
    batched = add_task_axis(theta)
    film = flow.log_density(batched, points)[0].exp().reshape(FILM_CELLS, FILM_CELLS)
    masses = make_guide_table(flow, theta, FILM_CELLS, DIRECTION_CELLS, power=1.0).masses
    cells_of_part = FILM_CELLS // FILM_PARTS
    masses = (masses * film.reshape(-1, 1)).reshape(
        FILM_PARTS, cells_of_part, FILM_PARTS, cells_of_part, DIRECTION_CELLS, DIRECTION_CELLS
    )
    return draw_densities(film[None] if scene is None else scene, masses.sum((1, 3)))


def draw_densities(film: Tensor, directions: Tensor) -> Tensor:
    """Draw densities on the film and of directions side by side, linear RGB [128, 256, 3].

    Args:
        film: a linear density or picture of any scale, [1 or 3, 32 or 64, as many]: on the left, tone-mapped.
        directions: a density of any scale, [4, 4, 16, 16], of each part of the film: on the right, divided by its mean
            in the part, the first coordinate to the right and the second down.
    """
    side = FILM_PARTS * PART_PX
    scaled_film = film / film.mean().clamp_min(1e-20)
    left = _enlarge(scaled_film.permute(1, 2, 0), side // film.shape[1]).expand(-1, -1, 3)
    relative_density = directions / directions.mean((2, 3), keepdim=True).clamp_min(1e-20)
    right = _enlarge(
        0.5
        * relative_density.permute(0, 3, 1, 2).reshape(FILM_PARTS * DIRECTION_CELLS, FILM_PARTS * DIRECTION_CELLS, 1),
        PART_PX // DIRECTION_CELLS,
    )
    right[::PART_PX], right[:, ::PART_PX] = 4.0, 4.0  # lines between the parts
    return srgb_to_linear(tone_map(torch.cat([left, right.expand(-1, -1, 3)], 1))).float()


def _enlarge(values: Tensor, times: int) -> Tensor:
    """Repeat each pixel of a picture [H, W, C] `times` down and across."""
    return values.repeat_interleave(times, 0).repeat_interleave(times, 1)
