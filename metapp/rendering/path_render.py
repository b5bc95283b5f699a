"""Pictures of a scene by path tracing: as it is, guided by a density over primary sample space, and for reference.

Places on the film are sampled evenly within each pixel. A guide samples the directions at the first surfaces that
scatter by its density q(directions | film). One path of four is left to the uniform density (defensive sampling), so
that the weight 1 / (1/4 + 3/4 q) of a path is never above 4 (the balance heuristic of Veach & Guibas 1995): pictures
are unbiased for every density that is positive or zero, and noisier where it is wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Generator, Tensor

from metapp.rendering.path_space import Tracer
from metapp.rendering.scene_text import SceneDict

UNIFORM = 4  # one path in so many is not guided

_BATCH = 2**18  # paths at a time
_REFERENCE_SPP = 2048


class Guide(NamedTuple):
    """A density of directions for places on the film, over the unit cube [0, 1)^k, k = 2 or 4.

    Attributes:
        sample: film [N, 2] to directions [N, k] and their density [N] > 0, by torch's own random numbers.
        density: film [N, 2] and directions [N, k] to the density [N] >= 0.
    """

    sample: Callable[[Tensor], tuple[Tensor, Tensor]]
    density: Callable[[Tensor, Tensor], Tensor]


def render(scene: SceneDict | Tracer, spp: int, size: int, seed: int = 0, guide: Guide | None = None) -> Tensor:
    """A picture [3, size, size], linear RGB radiance, of so many paths a pixel.

    Args:
        scene: a scene as `load_scene` takes it, or a tracer of one, which saves loading it again.
        spp: paths a pixel; every fourth is not guided.
        size: side of the picture, px.
        seed: of all draws; torch's global generator stays as it was.
        guide: of directions; None is Mitsuba's own sampling of each material, the baseline.

    Raises:
        ValueError: as `load_scene`; spp or size below 1.
    """
    tracer = scene if isinstance(scene, Tracer) else Tracer(scene)
    rng = Generator().manual_seed(seed)

    def radiance(film: Tensor, first: int) -> Tensor:
        if guide is None:
            return tracer.contributions(film, rng)
        points, weight = _guided(guide, film, first, rng)
        return tracer.contributions(points, rng) * weight[:, None]

    with torch.random.fork_rng(devices=range(torch.cuda.device_count())):
        torch.manual_seed(seed)
        return _picture(radiance, spp, size, rng)


def reference(scene: SceneDict | Tracer, size: int, spp: int = _REFERENCE_SPP, seed: int = 1) -> Tensor:
    """The picture that `render` tends to, with less noise: Mitsuba's `path`, which has next-event estimation.

    Args:
        scene: as for `render`.
        size: side of the picture, px; 64 take 7 s on one core.
        spp: paths a pixel.
        seed: of all draws.

    Returns:
        [3, size, size], linear RGB radiance.
    """
    tracer = scene if isinstance(scene, Tracer) else Tracer(scene)
    mi, rng = tracer.mi, Generator().manual_seed(seed)
    integrator = mi.load_dict({"type": "path", "max_depth": tracer.depth, "rr_depth": tracer.depth + 1})

    def radiance(film: Tensor, first: int) -> Tensor:
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(int(torch.randint(2**31, (), generator=rng)), len(film))
        place = mi.Point2f(*(mi.Float(column.contiguous().numpy()) for column in film.T))
        return torch.from_numpy(integrator.sample(tracer.scene, sampler, tracer.rays(place))[0].numpy()).T

    return _picture(radiance, spp, size, rng)


def _guided(guide: Guide, film: Tensor, first: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Points [N, 2 + k] and their weights [N]: directions of the guide, or, every fourth, uniform ones."""
    uniform = (torch.arange(first, first + len(film)) % UNIFORM) == 0
    directions, density = guide.sample(film[~uniform])
    others = torch.rand(int(uniform.sum()), directions.shape[1], generator=rng)
    points = film.new_empty(len(film), 2 + directions.shape[1])
    points[:, :2] = film
    points[~uniform, 2:], points[uniform, 2:] = directions.detach().to(film), others
    densities = film.new_empty(len(film))
    densities[~uniform] = density.detach().to(film)
    densities[uniform] = guide.density(film[uniform], others).detach().to(film)
    return points, 1 / (1 / UNIFORM + (1 - 1 / UNIFORM) * densities)


def _picture(radiance: Callable[[Tensor, int], Tensor], spp: int, size: int, rng: Generator) -> Tensor:
    """The mean over each pixel of the radiance at places on the film, numbered from its second argument on."""
    if spp < 1 or size < 1:
        raise ValueError(f"picture of {size} px and {spp} paths a pixel, expected 1 or more of both.")
    total = torch.zeros(size * size, 3, dtype=torch.float64)
    offset = int(torch.randint(UNIFORM, (), generator=rng))
    for first in range(0, size * size * spp, _BATCH):
        number = torch.arange(first, min(first + _BATCH, size * size * spp))
        pixel = number // spp
        corner = torch.stack([pixel % size, pixel // size], dim=1)
        film = (corner + torch.rand(len(number), 2, generator=rng)) / size
        total.index_add_(0, pixel, radiance(film, first + offset).double())
    return (total / spp).T.reshape(3, size, size).float()
