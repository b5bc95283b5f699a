"""The error that samples leave, and the directions to measure next, by the model of `network`.

Its covariance after samples depends on their colours through their brightness alone, so that directions
can be chosen before anything is measured: one after the other, each where the expected error of all directions falls
most (A-optimal design), and then all together by the gradient of that error.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from metapp.appearance.geometry import (
    directions_to_full_rusinkiewicz,
    half_difference_and_cosine,
    outgoing_cosine,
    quasirandom_angles,
)
from metapp.apps.brdf.brdf_network import opponent_axes
from metapp.apps.brdf.few.gaussian_model import error_slope, model_features, model_reflectance, sample_precision
from metapp.learning.task import Params

CANDIDATE_PAIRS, REFERENCE_PAIRS = 4096, 2048
CROWDING_POWER = 3  # the power that crowds the half vectors of candidates around the normal
REFINEMENT_STEPS, RATE_RAD = 60, 0.02  # of the gradient descent, which turns directions by so much a step at first
MEAN_ABSOLUTE_NORMAL = math.sqrt(2 / math.pi)  # the mean absolute value of a normal distribution of deviation 1


@dataclass(frozen=True)
class InstrumentLimits:
    """Limits of an instrument.

    Attributes:
        grazing_rad: light and detector are no further from the normal than this.
        apart_rad: nor nearer to each other than this, where one would shade the other.
        detector_rad: the angle from the normal where the detector, a camera, stands for all of them; None: anywhere.
    """

    grazing_rad: float = math.radians(80)
    apart_rad: float = math.radians(5)
    detector_rad: float | None = None

    def allowed(self, wi: Tensor, wo: Tensor) -> Tensor:
        """Bool [...] of unit vectors [..., 3] to light and detector."""
        low = torch.minimum(wi[..., 2], wo[..., 2]) >= math.cos(self.grazing_rad) - 1e-6
        result: Tensor = low & ((wi * wo).sum(-1) <= math.cos(self.apart_rad))
        return result


def places_at_angles(angles: Tensor) -> Tensor:
    """Half vector, difference vector and cos theta_i [1, 7, N] of angles [N, 3] in rad."""
    return half_difference_and_cosine(angles).T[None]


@dataclass(frozen=True)
class Posterior:
    """A material after samples: a fit by the model, one task's, [1, ...], and the covariance of its last layer.

    Attributes:
        theta: the fit, or the model's own mean.
        covariance: of the weights of each opponent axis, [3, F, F].
    """

    theta: Params
    covariance: Tensor

    @classmethod
    def of(cls, theta: Params, where: Tensor, slope: Tensor | None = None) -> Posterior:
        """Condition the model on samples.

        Args:
            theta: parameters of one task [1, ...].
            where: places of the samples, [1, 7, N]; N may be 0.
            slope: of the samples, [1, 3, N], as `network.slope_of` of measurements; None: of theta's reflectance.
        """
        if slope is None:
            slope = error_slope(model_reflectance(theta, where).clamp_min(0), where)
        features = model_features(theta, where)[0].double()
        gram = features * sample_precision(theta, slope)[0].double() @ features.T
        prior = torch.diag_embed(torch.exp(-2 * theta["deviation"][0].double()))
        return cls(theta, torch.cholesky_inverse(torch.linalg.cholesky(gram + prior)))

    def deviation(self, where: Tensor) -> Tensor:
        """Standard deviation of the logarithm of each channel, [3, N] of places [1, 7, N]."""
        features = model_features(self.theta, where)[0].to(self.covariance)
        axes = torch.einsum("fn,cfg,gn->cn", features, self.covariance, features).clamp_min(0)
        result: Tensor = (opponent_axes(axes).square() @ axes).sqrt()
        return result

    def expected_error(self, where: Tensor) -> Tensor:
        """Expected mean over channels of |log(1 + f cos theta_i) - ...|, [N] of places [1, 7, N]."""
        slope = error_slope(model_reflectance(self.theta, where).clamp_min(0), where)[0]
        return MEAN_ABSOLUTE_NORMAL * (slope * self.deviation(where)).mean(0)


@functools.cache
def spread_places(count: int = 512) -> Tensor:
    """Places [1, 7, count] of `quasirandom_angles`."""
    return places_at_angles(quasirandom_angles(count))


def expected_errors(posterior: Posterior) -> dict[str, float]:
    """The expected error over all directions, in highlights (half vector within 10 degrees) and beyond 70 degrees."""
    where = spread_places()
    errors = posterior.expected_error(where)
    highlight = where[0, 2] > math.cos(math.radians(10))
    grazing = torch.minimum(where[0, 6], outgoing_cosine(where)[0]) < math.cos(math.radians(70))
    parts = {"": errors, "_highlight": errors[highlight], "_grazing": errors[grazing]}
    return {f"expected{part}": float(some.mean()) for part, some in parts.items()}


def plan_directions(
    theta: Params, count: int, limits: InstrumentLimits, seen: Tensor, rng: Generator
) -> tuple[Tensor, Tensor]:
    """Choose the directions to measure.

    Args:
        theta: the model, or a fit by it, [1, ...].
        count: of pairs of directions.
        limits: of the instrument.
        seen: angles [M, 3] in rad of earlier measurements.
        rng: of candidates.

    Returns:
        Unit vectors to light and detector, [count, 3] each, phi_o = 0, the most telling first.

    Raises:
        ValueError: no direction is within the limits.
    """
    free = _candidates(limits, rng)
    wi, wo = _directions(free)
    free = free[limits.allowed(wi, wo)]
    if len(free) < count:
        raise ValueError(
            f"{len(free)} of {CANDIDATE_PAIRS} pairs of directions within the limits, expected {count} or more; raise "
            "--grazing, or lower --apart or --detector."
        )
    others = spread_places(REFERENCE_PAIRS)
    theta = {key: value.detach() for key, value in theta.items()}
    before = places_at_angles(seen.float())
    with torch.no_grad():
        chosen = free[_greedy(theta, Posterior.of(theta, before), _places(free), others, count)]
    return _directions(_refined(theta, chosen, limits, before, others))


def _candidates(limits: InstrumentLimits, rng: Generator) -> Tensor:
    """Polar angles of the detector and of the half vector, and the azimuth between them, [CANDIDATES, 3] rad."""
    draws = torch.rand(CANDIDATE_PAIRS, 3, generator=rng)
    detector = draws[:, 0] * limits.grazing_rad
    if limits.detector_rad is not None:
        detector = torch.full_like(detector, limits.detector_rad)
    return torch.stack([detector, draws[:, 1] ** CROWDING_POWER * math.pi / 2, draws[:, 2] * math.pi], 1)


def _directions(free: Tensor) -> tuple[Tensor, Tensor]:
    """Light and detector [N, 3] of `_candidates`."""
    detector, half, azimuth = free.unbind(1)
    wo = torch.stack([detector.sin(), torch.zeros_like(detector), detector.cos()], 1)
    h = torch.stack([half.sin() * azimuth.cos(), half.sin() * azimuth.sin(), half.cos()], 1)
    return 2 * (h * wo).sum(1, keepdim=True) * h - wo, wo


def _places(free: Tensor) -> Tensor:
    return places_at_angles(directions_to_full_rusinkiewicz(*_directions(free)))


def _greedy(theta: Params, posterior: Posterior, where: Tensor, others: Tensor, count: int) -> list[int]:
    """Indices of candidates [1, 7, N], one after the other where the expected square error falls most."""
    weights = sample_precision(theta, error_slope(model_reflectance(theta, where).clamp_min(0), where))[0].double()
    slope = error_slope(model_reflectance(theta, others).clamp_min(0), others)[0].double()
    features, goal = model_features(theta, where)[0].double(), model_features(theta, others)[0].double() * slope.mean(0)
    total, covariance = goal @ goal.T, posterior.covariance
    chosen: list[int] = []
    for _ in range(count):
        mapped = covariance @ features  # [3, F, N]
        spread = 1 / weights + (mapped * features).sum(1)
        gain = ((total @ mapped) * mapped).sum(1) / spread
        best = int(gain.sum(0).argmax())
        chosen.append(best)
        column = mapped[:, :, best]
        covariance = covariance - column[:, :, None] * column[:, None] / spread[:, best, None, None]
    return chosen


def _refined(theta: Params, free: Tensor, limits: InstrumentLimits, before: Tensor, others: Tensor) -> Tensor:
    """Candidates after steps along the gradient of the expected error, as far as the limits allow."""
    free = free.clone()
    best, least = free, math.inf
    moment, square = torch.zeros_like(free), torch.zeros_like(free)
    movable = torch.tensor([limits.detector_rad is None, True, True])
    for step in range(REFINEMENT_STEPS + 1):
        free.requires_grad_()
        where = torch.cat([before, _places(free)], 2)
        error = Posterior.of(theta, where).expected_error(others).mean()
        if error.item() < least:
            best, least = free.detach(), error.item()
        (gradient,) = torch.autograd.grad(error, free)
        free = free.detach()
        moment, square = 0.8 * moment + 0.2 * gradient, 0.95 * square + 0.05 * gradient.square()
        moved = free - RATE_RAD * (1 - step / (REFINEMENT_STEPS + 1)) * movable * moment / (square.sqrt() + 1e-12)
        moved[:, 0].clamp_(0, limits.grazing_rad)
        free = torch.where(limits.allowed(*_directions(moved))[:, None], moved, free)
    return best
