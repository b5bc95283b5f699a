"""Baselines of illumination networks: spherical harmonics of a map; of a photo the light in a mirror ball."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Generator, Tensor

from metapp.appearance.latlong import mean_luminance
from metapp.extensions.baselines.baseline import Baseline, BaselineFit, CostLimits
from metapp.extensions.baselines.harmonics import count_orders, from_harmonics, to_harmonics
from metapp.learning.app import App
from metapp.learning.task import Batch, Tasks

SCALE_BYTES, COEFFICIENT_BYTES = 4, 2  # bytes of a scale, a float, and of a coefficient over it, half a float


def baselines(app: App) -> tuple[Baseline, ...]:
    """Of maps, or of photographs, by the protocol."""
    return (UnwrappedBall(app) if app.protocol == "photo" else SphericalHarmonics(app),)


class SphericalHarmonics(Baseline):
    """As many coefficients, half floats over their largest, as take no more bytes than a network."""

    name = "sh"
    title = "spherical harmonics, least squares by solid angle"
    cannot = "read a map from a photo, nor show a sun that does not ring"

    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        """The coefficients of a map."""
        (row,) = tasks.rows.tolist()
        radiance = tasks.data["map"][row].double().numpy()
        channels, height, width = radiance.shape
        most = math.isqrt(max(0, allowed.network_bytes - SCALE_BYTES) // (COEFFICIENT_BYTES * channels)) - 1
        coefficients = to_harmonics(radiance, max(0, min(most, count_orders(height, width) - 1)))
        scale = float(np.abs(coefficients).max()) or 1.0
        kept = (coefficients / scale).astype(np.float16)

        def answer() -> Tensor:
            return torch.from_numpy(from_harmonics(kept.astype(np.float64) * scale, height, width)).float()[None]

        return BaselineFit(answer, kept.size, SCALE_BYTES + COEFFICIENT_BYTES * kept.size)


class UnwrappedBall(Baseline):
    """The light that a mirror ball shows."""

    name = "unwrap"
    title = "what a mirror ball shows, as it is"
    cannot = "tell what the photo does not show"
    stored = "seen"

    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        """The map that is seen; ValueError: the ball is no mirror."""
        data = {key: tasks.data[key][tasks.rows] for key in ("seen", "certain")}
        for name, certain in zip(tasks.selected_names, data["certain"], strict=True):
            if not certain.any():
                raise ValueError(f"{name}: a photo of a glossy sphere, expected a mirror ball's.")
        numbers = 5 * data["seen"][0, 0].numel()
        return BaselineFit(lambda: fill_unseen(data), numbers, 2 * numbers)


def fill_unseen(data: Batch) -> Tensor:
    """Maps [T, 3, H, W] of `seen` [T, 3, H, W] and `certain` [T, 2, H, W].

    Behind a ball is the light before it; where neither is known the mean; where the photo clips the light of the clip.
    """
    seen, share = data["seen"], data["certain"].sum(1, keepdim=True)
    behind, there = (each.flip(-1).roll(each.shape[-1] // 2, -1) for each in (seen, share))
    mean = (mean_luminance(seen * share) / mean_luminance(share.expand_as(seen)).clamp_min(1e-6))[:, None, None, None]
    return torch.lerp(torch.lerp(mean, behind, there), seen, share)
