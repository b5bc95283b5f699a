"""Densities of light paths as pictures."""

from __future__ import annotations

import torch
from torch import Tensor

from metapp.appearance.colour import srgb_to_linear, tone_map
from metapp.apps.transport.flow import DIRECTION_COORDINATES, Flow
from metapp.apps.transport.guide import make_guide_table
from metapp.learning.task import Params

FILM_CELLS, FILM_PARTS, DIRECTION_CELLS = 32, 4, 16  # places along the film, parts of it, cells of directions in each
PART_PX = 32  # px of a part


def draw_sample_histograms(samples: Tensor, scene: Tensor | None = None) -> Tensor:
    """Histograms of samples [N, 4 or more], as `draw_densities` shows densities, or the scene's picture and one histogram."""
    film, parts, cells = ((samples * n).long().clamp_max(n - 1) for n in (FILM_CELLS, FILM_PARTS, DIRECTION_CELLS))
    on_film = (
        torch.bincount(film[:, 1] * FILM_CELLS + film[:, 0], minlength=FILM_CELLS**2)
        .float()
        .reshape(1, FILM_CELLS, FILM_CELLS)
    )
    index = ((parts[:, 1] * FILM_PARTS + parts[:, 0]) * DIRECTION_CELLS + cells[:, 2]) * DIRECTION_CELLS + cells[:, 3]
    towards = torch.bincount(index, minlength=(FILM_PARTS * DIRECTION_CELLS) ** 2).float()
    return draw_densities(
        on_film if scene is None else scene, towards.reshape(FILM_PARTS, FILM_PARTS, DIRECTION_CELLS, DIRECTION_CELLS)
    )


@torch.no_grad()
def draw_flow_density(flow: Flow, theta: Params, scene: Tensor | None = None) -> Tensor:
    """The density of a fit, no task axis in theta, as `draw_densities` shows it, or a picture instead of its film."""
    middles = (torch.arange(FILM_CELLS) + 0.5) / FILM_CELLS
    y, x = (each.flatten() for each in torch.meshgrid(middles, middles, indexing="ij"))
    points = torch.stack([x, y, *[torch.full_like(x, 0.5)] * DIRECTION_COORDINATES])[None]
    one = {key: value[None] for key, value in theta.items()}
    film = flow.log_density(one, points)[0].exp().reshape(FILM_CELLS, FILM_CELLS)
    table = make_guide_table(flow, theta, FILM_CELLS, DIRECTION_CELLS, power=1.0).masses
    table = (table * film.reshape(-1, 1)).reshape(
        FILM_PARTS, FILM_CELLS // FILM_PARTS, FILM_PARTS, FILM_CELLS // FILM_PARTS, DIRECTION_CELLS, DIRECTION_CELLS
    )
    return draw_densities(film[None] if scene is None else scene, table.sum((1, 3)))


def draw_densities(film: Tensor, directions: Tensor) -> Tensor:
    """Both side by side, linear RGB [128, 256, 3].

    Args:
        film: linear, of any scale, [1 or 3, 32 or 64, as many]: on the left, tone-mapped.
        directions: a density of any scale, [4, 4, 16, 16], of each part of the film: on the right, of a mean of its
            own, the first coordinate to the right and the second down.
    """
    side = FILM_PARTS * PART_PX
    scaled = film / film.mean().clamp_min(1e-20)
    left = _enlarged(scaled.permute(1, 2, 0), side // film.shape[1]).expand(-1, -1, 3)
    parts = directions / directions.mean((2, 3), keepdim=True).clamp_min(1e-20)
    right = _enlarged(
        0.5 * parts.permute(0, 3, 1, 2).reshape(FILM_PARTS * DIRECTION_CELLS, FILM_PARTS * DIRECTION_CELLS, 1),
        PART_PX // DIRECTION_CELLS,
    )
    right[::PART_PX], right[:, ::PART_PX] = 4.0, 4.0  # lines between the parts
    return srgb_to_linear(tone_map(torch.cat([left, right.expand(-1, -1, 3)], 1))).float()


def _enlarged(values: Tensor, times: int) -> Tensor:
    return values.repeat_interleave(times, 0).repeat_interleave(times, 1)
