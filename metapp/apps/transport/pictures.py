"""Densities of light paths as pictures."""

from __future__ import annotations

import torch
from torch import Tensor

from metapp.appearance.colour import srgb_to_linear, tone_map
from metapp.apps.transport.flow import DIRECTIONS, Flow
from metapp.apps.transport.guide import table_of
from metapp.learning.task import Params

FILM, PARTS, CELLS = 32, 4, 16  # places along the film, parts of it, cells of directions in each
PART_PX = 32  # px of a part


def picture_of_samples(samples: Tensor, scene: Tensor | None = None) -> Tensor:
    """Histograms of samples [N, 4 or more], as `picture` shows densities, or the scene's picture and one histogram."""
    film, parts, cells = ((samples * n).long().clamp_max(n - 1) for n in (FILM, PARTS, CELLS))
    on_film = torch.bincount(film[:, 1] * FILM + film[:, 0], minlength=FILM**2).float().reshape(1, FILM, FILM)
    index = ((parts[:, 1] * PARTS + parts[:, 0]) * CELLS + cells[:, 2]) * CELLS + cells[:, 3]
    towards = torch.bincount(index, minlength=(PARTS * CELLS) ** 2).float()
    return picture(on_film if scene is None else scene, towards.reshape(PARTS, PARTS, CELLS, CELLS))


@torch.no_grad()
def picture_of_flow(flow: Flow, theta: Params, scene: Tensor | None = None) -> Tensor:
    """The density of a fit, no task axis in theta, as `picture` shows it, or a picture instead of its film."""
    middles = (torch.arange(FILM) + 0.5) / FILM
    y, x = (each.flatten() for each in torch.meshgrid(middles, middles, indexing="ij"))
    points = torch.stack([x, y, *[torch.full_like(x, 0.5)] * DIRECTIONS])[None]
    one = {key: value[None] for key, value in theta.items()}
    film = flow.log_density(one, points)[0].exp().reshape(FILM, FILM)
    table = table_of(flow, theta, FILM, CELLS, power=1.0).masses
    table = (table * film.reshape(-1, 1)).reshape(PARTS, FILM // PARTS, PARTS, FILM // PARTS, CELLS, CELLS)
    return picture(film[None] if scene is None else scene, table.sum((1, 3)))


def picture(film: Tensor, directions: Tensor) -> Tensor:
    """Both side by side, linear RGB [128, 256, 3].

    Args:
        film: linear, of any scale, [1 or 3, 32 or 64, as many]: on the left, tone-mapped.
        directions: a density of any scale, [4, 4, 16, 16], of each part of the film: on the right, of a mean of its
            own, the first coordinate to the right and the second down.
    """
    side = PARTS * PART_PX
    scaled = film / film.mean().clamp_min(1e-20)
    left = _enlarged(scaled.permute(1, 2, 0), side // film.shape[1]).expand(-1, -1, 3)
    parts = directions / directions.mean((2, 3), keepdim=True).clamp_min(1e-20)
    right = _enlarged(0.5 * parts.permute(0, 3, 1, 2).reshape(PARTS * CELLS, PARTS * CELLS, 1), PART_PX // CELLS)
    right[::PART_PX], right[:, ::PART_PX] = 4.0, 4.0  # lines between the parts
    return srgb_to_linear(tone_map(torch.cat([left, right.expand(-1, -1, 3)], 1))).float()


def _enlarged(values: Tensor, times: int) -> Tensor:
    return values.repeat_interleave(times, 0).repeat_interleave(times, 1)
