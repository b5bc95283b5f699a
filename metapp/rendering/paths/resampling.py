"""Samples of light paths if rejection accepts hardly any: small lamps, and lights that no path meets by chance.

Paths with next-event estimation (`metapp.rendering.paths.next_event`) are resampled in proportion to their luminance
(sampling importance resampling), then moved by Metropolis and Hastings' rule, which leaves that proportion as it is and
parts those that were drawn more than once (resample-move, Gilks & Berzuini 2001). A path keeps the luminance that it
was accepted by, so that the random numbers which no point holds are integrated exactly (Andrieu & Roberts 2009).
"""

from __future__ import annotations

import torch
from torch import Generator, Tensor

from metapp.rendering.paths.path_space import BELOW_ONE, DIMENSIONS, FewPaths, ImageSum, Tracer, path_samples
from metapp.rendering.scenes.loading import brightness

ENOUGH_PER_SAMPLE = 0.25  # effective paths of the pool, for each sample
FEWEST_PATHS = 256  # of these at all
MOST_BATCHES, LAST_BATCH = 32, 128  # batches of the pool, and of one that has not the fewest yet
DARK_BATCHES = 4  # batches without any light that are enough
MOVES = 24  # proposals for each sample
STEP_DEVIATIONS = (2.0**-12, 2.0**-3)  # standard deviation of proposals in each number, log-uniform


def draw_samples(tracer: Tracer, count: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Samples as of `path_samples`, or resampled if there are too few; that sets `next_event` of the tracer.

    Raises:
        ValueError: hardly any path meets a light, even so.
    """
    if not tracer.next_event:
        try:
            return path_samples(tracer, count, rng)
        except FewPaths:
            tracer.next_event = True
    return resampled(tracer, count, rng)


def resampled(tracer: Tracer, count: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Points of primary sample space in proportion to the luminance of their paths, by resample-move.

    Points are in the order of the pool that they come from: two parts of them have at most one path in common.

    Args:
        tracer: of the scene, with next-event estimation.
        count: points wanted.
        rng: of all draws.

    Returns:
        As `path_samples`.

    Raises:
        FewPaths: too few paths meet a light.
    """
    points, weights, image = _pool(tracer, count, rng)
    ends = weights[:, 0].double().cumsum(0)
    places = (torch.arange(count) + torch.rand(1, generator=rng, dtype=torch.float64)) * (ends[-1] / count)
    rows = torch.searchsorted(ends, places, right=True).clamp_max(len(ends) - 1)
    return _moved(tracer, points[rows], weights[rows, 1], rng), image


def _pool(tracer: Tracer, count: int, rng: Generator) -> tuple[Tensor, Tensor, Tensor]:
    """Points [P, d], their weights and luminances [P, 2], and the picture of all paths.

    Dark paths are kept by chance, with a weight that makes up for it, so that memory is bounded.
    """
    kept, weights, image = [], [], ImageSum()
    first, second, batch = 0.0, 0.0, tracer.batch_paths
    for number in range(1, LAST_BATCH + 1):
        points = torch.rand(batch, DIMENSIONS, generator=rng)
        carried = tracer.contributions(points, rng)
        image.add(points, carried)
        bright = brightness(carried).clamp_min(0)
        first, second = first + float(bright.double().sum()), second + float(bright.double().square().sum())
        least = float(bright.double().sum()) / (2 * count)
        keep = (torch.rand(batch, generator=rng) * least < bright) & (bright > 0)
        kept.append(points[keep])
        weights.append(torch.stack([bright.clamp_min(least), bright], 1)[keep])
        effective = first**2 / second if second else 0.0
        if effective >= FEWEST_PATHS and (number >= MOST_BATCHES or effective >= ENOUGH_PER_SAMPLE * count):
            break
        if not effective and number >= DARK_BATCHES:
            break
    if effective < FEWEST_PATHS:
        kinds = {emitter.class_name() for emitter in tracer.scene.emitters()}
        only = " (its only light is a projector)" if kinds == {"Projector"} else ""
        raise FewPaths(
            f"{effective:.0f} of {number * batch:,} paths meet a light{only}, expected {FEWEST_PATHS} or more, counted "
            "by what they carry; point the camera at surfaces that light reaches, turn or enlarge the lights."
        )
    return torch.cat(kept), torch.cat(weights), image.mean()


def _moved(tracer: Tracer, points: Tensor, bright: Tensor, rng: Generator) -> Tensor:
    """Points [N, d] after MOVES proposals, of these luminances [N] before; the unit cube is periodic."""
    low, high = (torch.tensor(step).log() for step in STEP_DEVIATIONS)
    for _ in range(MOVES):
        scale = (low + (high - low) * torch.rand(len(points), 1, generator=rng)).exp()
        step = scale * torch.randn(points.shape, generator=rng)
        step[:, :2] *= torch.rand(len(points), 1, generator=rng) < 0.5  # half of them stay where they are on the film
        tried = (points + step).remainder(1).clamp_max(BELOW_ONE)
        found = brightness(tracer.contributions(tried, rng))
        accepted = torch.rand(len(points), generator=rng) * bright < found
        points = torch.where(accepted[:, None], tried, points)
        bright = torch.where(accepted, found, bright)
    return points.contiguous()
