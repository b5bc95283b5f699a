"""Baselines of illumination: spherical harmonics of a map, and the light that a mirror ball in a photograph shows.

Each serves one kind of fits: the first reads the map itself, the second the light that a task holds of a photographed
mirror ball. The mathematics of spherical harmonics is in `harmonics`.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.latlong import mean_luminance
from metapp.apps.illumination.app import Illumination
from metapp.apps.illumination.ball_sight import BallSight
from metapp.apps.illumination.mirror import MirrorLight
from metapp.apps.illumination.radiance import radiance_of
from metapp.extensions.baselines.baseline import Baseline, BaselineFit, CostLimits
from metapp.extensions.baselines.harmonics import count_orders, from_harmonics, to_harmonics
from metapp.learning.task import Tasks

SCALE_BYTES, COEFFICIENT_BYTES = 4, 2  # of the scale, a float, and of a coefficient divided by it, half a float


def baselines(app: Illumination) -> tuple[Baseline, ...]:
    """Return the baseline of the application, whose fits see a map or a photograph."""
    return (UnwrappedBall(app) if isinstance(app.sight, BallSight) else SphericalHarmonics(app),)


class SphericalHarmonics(Baseline):
    """Spherical harmonics in as many half floats, divided by the largest, as take no more bytes than a network."""

    name = "sh"
    title = "spherical harmonics, least squares by solid angle"
    cannot = "read a map from a photo, nor show a sun that does not ring"

    @override
    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        (row,) = tasks.rows.tolist()
        radiance = tasks.data["map"][row].double().numpy()
        channels, height, width = radiance.shape
        max_order = math.isqrt(max(0, allowed.network_bytes - SCALE_BYTES) // (COEFFICIENT_BYTES * channels)) - 1
        coefficients = to_harmonics(radiance, max(0, min(max_order, count_orders(height, width) - 1)))
        scale = float(np.abs(coefficients).max()) or 1.0
        stored_coefficients = (coefficients / scale).astype(np.float16)

        def prediction() -> Tensor:
            return torch.from_numpy(
                from_harmonics(stored_coefficients.astype(np.float64) * scale, height, width)
            ).float()[None]

        kept_bytes = SCALE_BYTES + COEFFICIENT_BYTES * stored_coefficients.size
        return BaselineFit(
            prediction, stored_coefficients.size, kept_bytes, lambda task, size: radiance_of(prediction(), task)
        )


class UnwrappedBall(Baseline):
    """The light that a mirror ball shows; a fit stores the unwrapped map and where it is certain."""

    name = "unwrap"
    title = "what a mirror ball shows, as it is"
    cannot = "tell what the photo does not show"
    stored_tensor = "seen"

    @override
    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        """Raise ValueError if the ball is no mirror."""
        light = MirrorLight(**tasks.gather(MirrorLight._fields))
        for name, certain in zip(tasks.selected_names, light.certain, strict=True):
            if not certain.any():
                raise ValueError(f"{name}: a photo of a glossy sphere, expected a mirror ball's.")
        numbers = 5 * light.seen[0, 0].numel()
        return BaselineFit(
            lambda: fill_unseen(light), numbers, 2 * numbers, lambda task, size: radiance_of(fill_unseen(light), task)
        )


def fill_unseen(light: MirrorLight) -> Tensor:
    """Return maps in which directions that a ball does not show are filled in.

    Behind the ball is a copy of the light in front of it; where neither is known stands the mean; where the photograph
    clips stands the light at which it clips.

    Args:
        light: the light that mirror balls show.

    Returns:
        The maps, [T, 3, H, W].
    """
    seen, share = light.seen, light.certain.sum(1, keepdim=True)
    behind, behind_share = (values.flip(-1).roll(values.shape[-1] // 2, -1) for values in (seen, share))
    mean = (mean_luminance(seen * share) / mean_luminance(share.expand_as(seen)).clamp_min(1e-6))[:, None, None, None]
    return torch.lerp(torch.lerp(mean, behind, behind_share), seen, share)
