"""Samples of light paths if rejection accepts hardly any: small lamps, and lights that no path meets by chance.

Paths with next-event estimation (:mod:`metapp.rendering.paths.next_event`) are resampled in proportion to their
luminance (sampling importance resampling), then moved by Metropolis and Hastings' rule, which leaves that proportion as
it is and separates paths that were drawn more than once (resample-move, Gilks & Berzuini 2001). A path keeps the
luminance that it was accepted by, so that the random numbers which no point holds are integrated exactly (Andrieu &
Roberts 2009).
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

ENOUGH_PATHS_PER_SAMPLE = 0.25  # effective paths of a pool that is large enough, for each sample
MIN_EFFECTIVE_PATHS = 256  # least number of effective paths of a pool
MAX_POOL_BATCHES, LAST_POOL_BATCH = 32, 128  # batches of a pool; and while it has fewer than MIN_EFFECTIVE_PATHS
MAX_DARK_BATCHES = 4  # batches without any light after which a scene is given up
PROPOSALS_PER_SAMPLE = 24  # Metropolis proposals for each sample
PROPOSAL_DEVIATIONS = (2.0**-12, 2.0**-3)  # range of the standard deviation of proposals, drawn log-uniformly


def draw_path_samples(tracer: Tracer, count: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Draw points of primary sample space in proportion to the luminance of their paths.

    By rejection, or, if that accepts too few paths, by resampling, which sets `next_event` of the tracer.

    Args:
        tracer: the scene's tracer.
        count: number of points.
        rng: makes all draws.

    Returns:
        points float32 [count, POINT_DIMENSIONS]; and the picture of all paths, float32 [3, 32, 32], linear RGB.

    Raises:
        TooFewPathsError: hardly any path meets a light, even so.
    """
    if not tracer.next_event:
        try:
            return sample_by_rejection(tracer, count, rng)
        except TooFewPathsError:
            tracer.next_event = True
    return sample_by_resampling(tracer, count, rng)


def sample_by_resampling(tracer: Tracer, count: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Draw points of primary sample space in proportion to the luminance of their paths, by resample-move.

    Points are in the order of the pool that they come from: two parts of them have at most one path in common.

    Args:
        tracer: the scene's tracer, with next-event estimation.
        count: number of points.
        rng: makes all draws.

    Returns:
        points float32 [count, POINT_DIMENSIONS]; and the picture of all paths, float32 [3, 32, 32], linear RGB.

    Raises:
        TooFewPathsError: too few paths meet a light.
    """
    points, weights, image = _trace_pool(tracer, count, rng)
    cumulative_weights = weights[:, 0].double().cumsum(0)
    quantiles = (torch.arange(count) + torch.rand(1, generator=rng, dtype=torch.float64)) * (
        cumulative_weights[-1] / count
    )
    rows = torch.searchsorted(cumulative_weights, quantiles, right=True).clamp_max(len(cumulative_weights) - 1)
    return _move_points(tracer, points[rows], weights[rows, 1], rng), image


def _trace_pool(tracer: Tracer, count: int, rng: Generator) -> tuple[Tensor, Tensor, Tensor]:
    """Trace paths until their pool is large enough to resample from.

    Dark paths are kept by chance, with a weight that makes up for it, so that memory is bounded.

    Returns:
        points [P, d], their weights and luminances [P, 2], and the picture of all paths.
    """
    kept_points, weights, image = [], [], ImageSum()
    luminance_sum, luminance_square_sum, batch_paths = 0.0, 0.0, tracer.batch_paths
    for number in range(1, LAST_POOL_BATCH + 1):
        points = torch.rand(batch_paths, POINT_DIMENSIONS, generator=rng)
        radiance = tracer.trace_radiance(points, rng)
        image.add(points, radiance)
        brightness = colour_luminance(radiance).clamp_min(0)
        luminance_sum, luminance_square_sum = (
            luminance_sum + float(brightness.double().sum()),
            luminance_square_sum + float(brightness.double().square().sum()),
        )
        dark_weight = float(brightness.double().sum()) / (2 * count)
        is_kept = (torch.rand(batch_paths, generator=rng) * dark_weight < brightness) & (brightness > 0)
        kept_points.append(points[is_kept])
        weights.append(torch.stack([brightness.clamp_min(dark_weight), brightness], 1)[is_kept])
        effective_paths = luminance_sum**2 / luminance_square_sum if luminance_square_sum else 0.0
        if effective_paths >= MIN_EFFECTIVE_PATHS and (
            number >= MAX_POOL_BATCHES or effective_paths >= ENOUGH_PATHS_PER_SAMPLE * count
        ):
            break
        if not effective_paths and number >= MAX_DARK_BATCHES:
            break
    if effective_paths < MIN_EFFECTIVE_PATHS:
        emitter_classes = {emitter.class_name() for emitter in tracer.scene.emitters()}
        projector_note = " (its only light is a projector)" if emitter_classes == {"Projector"} else ""
        raise TooFewPathsError(
            f"{effective_paths:.0f} of {number * batch_paths:,} paths meet a light{projector_note}, "
            f"expected {MIN_EFFECTIVE_PATHS} or more, weighted by their radiance; "
            "point the camera at surfaces that light reaches, turn or enlarge the lights."
        )
    return torch.cat(kept_points), torch.cat(weights), image.mean()


def _move_points(tracer: Tracer, points: Tensor, brightness: Tensor, rng: Generator) -> Tensor:
    """Move points [N, d] by PROPOSALS_PER_SAMPLE proposals each; the unit cube is periodic.

    Args:
        tracer: the scene's tracer.
        points: float32 [N, d] in [0, 1).
        brightness: their luminances [N].
        rng: makes all draws.
    """
    low, high = (torch.tensor(step).log() for step in PROPOSAL_DEVIATIONS)
    for _ in range(PROPOSALS_PER_SAMPLE):
        scale = (low + (high - low) * torch.rand(len(points), 1, generator=rng)).exp()
        step = scale * torch.randn(points.shape, generator=rng)
        # half of the proposals stay where they are on the film
        step[:, :2] *= torch.rand(len(points), 1, generator=rng) < 0.5
        proposals = (points + step).remainder(1).clamp_max(BELOW_ONE)
        proposed_brightness = colour_luminance(tracer.trace_radiance(proposals, rng))
        accepted = torch.rand(len(points), generator=rng) * brightness < proposed_brightness
        points = torch.where(accepted[:, None], proposals, points)
        brightness = torch.where(accepted, proposed_brightness, brightness)
    return points.contiguous()
