"""Samples of light paths if rejection accepts hardly any: small lamps, and lights that no path meets by chance.

Paths with next-event estimation (`metapp.rendering.paths.next_event`) are resampled in proportion to their luminance
(sampling importance resampling), then moved by Metropolis and Hastings' rule, which leaves that proportion as it is and
parts those that were drawn more than once (resample-move, Gilks & Berzuini 2001). A path keeps the luminance that it
was accepted by, so that the random numbers which no point holds are integrated exactly (Andrieu & Roberts 2009).
"""

from __future__ import annotations

import torch
from torch import Generator, Tensor

from metapp.rendering.paths.path_space import (
    BELOW_ONE,
    POINT_DIMENSIONS,
    ImageSum,
    TooFewPathsError,
    Tracer,
    sample_by_rejection,
)
from metapp.rendering.scenes.loading import colour_luminance

ENOUGH_PATHS_PER_SAMPLE = 0.25  # effective paths of the pool, for each sample
MIN_EFFECTIVE_PATHS = 256  # of these at all
MAX_POOL_BATCHES, LAST_POOL_BATCH = 32, 128  # batches of the pool, and of one that has not the fewest yet
MAX_DARK_BATCHES = 4  # batches without any light that are enough
PROPOSALS_PER_SAMPLE = 24  # proposals for each sample
PROPOSAL_DEVIATIONS = (2.0**-12, 2.0**-3)  # standard deviation of proposals in each number, log-uniform


def draw_path_samples(tracer: Tracer, count: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Samples as of `sample_by_rejection`, or resampled if there are too few; that sets `next_event` of the tracer.

    Raises:
        ValueError: hardly any path meets a light, even so.
    """
    if not tracer.next_event:
        try:
            return sample_by_rejection(tracer, count, rng)
        except TooFewPathsError:
            tracer.next_event = True
    return sample_by_resampling(tracer, count, rng)


def sample_by_resampling(tracer: Tracer, count: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Points of primary sample space in proportion to the luminance of their paths, by resample-move.

    Points are in the order of the pool that they come from: two parts of them have at most one path in common.

    Args:
        tracer: of the scene, with next-event estimation.
        count: points wanted.
        rng: of all draws.

    Returns:
        As `sample_by_rejection`.

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
    for number in range(1, LAST_POOL_BATCH + 1):
        points = torch.rand(batch, POINT_DIMENSIONS, generator=rng)
        carried = tracer.contributions(points, rng)
        image.add(points, carried)
        bright = colour_luminance(carried).clamp_min(0)
        first, second = first + float(bright.double().sum()), second + float(bright.double().square().sum())
        least = float(bright.double().sum()) / (2 * count)
        keep = (torch.rand(batch, generator=rng) * least < bright) & (bright > 0)
        kept.append(points[keep])
        weights.append(torch.stack([bright.clamp_min(least), bright], 1)[keep])
        effective = first**2 / second if second else 0.0
        if effective >= MIN_EFFECTIVE_PATHS and (
            number >= MAX_POOL_BATCHES or effective >= ENOUGH_PATHS_PER_SAMPLE * count
        ):
            break
        if not effective and number >= MAX_DARK_BATCHES:
            break
    if effective < MIN_EFFECTIVE_PATHS:
        kinds = {emitter.class_name() for emitter in tracer.scene.emitters()}
        only = " (its only light is a projector)" if kinds == {"Projector"} else ""
        raise TooFewPathsError(
            f"{effective:.0f} of {number * batch:,} paths meet a light{only}, expected {MIN_EFFECTIVE_PATHS} or more, counted "
            "by what they carry; point the camera at surfaces that light reaches, turn or enlarge the lights."
        )
    return torch.cat(kept), torch.cat(weights), image.mean()


def _moved(tracer: Tracer, points: Tensor, bright: Tensor, rng: Generator) -> Tensor:
    """Points [N, d] after MOVES proposals, of these luminances [N] before; the unit cube is periodic."""
    low, high = (torch.tensor(step).log() for step in PROPOSAL_DEVIATIONS)
    for _ in range(PROPOSALS_PER_SAMPLE):
        scale = (low + (high - low) * torch.rand(len(points), 1, generator=rng)).exp()
        step = scale * torch.randn(points.shape, generator=rng)
        step[:, :2] *= torch.rand(len(points), 1, generator=rng) < 0.5  # half of them stay where they are on the film
        tried = (points + step).remainder(1).clamp_max(BELOW_ONE)
        found = colour_luminance(tracer.contributions(tried, rng))
        accepted = torch.rand(len(points), generator=rng) * bright < found
        points = torch.where(accepted[:, None], tried, points)
        bright = torch.where(accepted, found, bright)
    return points.contiguous()
