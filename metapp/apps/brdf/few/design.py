"""The error that samples leave, and the directions to measure next, by the model of `gaussian_model`.

The model's covariance after samples depends on their colours through their brightness alone, so that directions can be
chosen before anything is measured: one after the other, each where the expected error of all directions falls most
(A-optimal design), and then all together by the gradient of that error.
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

CANDIDATE_PAIRS, REFERENCE_PAIRS = 4096, 2048  # pairs to choose from, and pairs whose mean expected error is lowered
CROWDING_POWER = 3  # the power that crowds the half vectors of candidates around the normal
# steps of gradient descent, and the angle by which the first of them turns directions
REFINEMENT_STEPS, RATE_RAD = 60, 0.02
MEAN_ABSOLUTE_NORMAL = math.sqrt(2 / math.pi)  # the mean absolute value of a normal distribution of deviation 1


@dataclass(frozen=True)
class InstrumentLimits:
    """Limits of the directions that an instrument measures.

    Attributes:
        grazing_rad: the greatest angle of light and detector from the normal.
        apart_rad: the least angle between light and detector; nearer to each other, one would shade the other.
        detector_rad: the angle from the normal where the detector, a camera, stands for all measurements; None:
            anywhere.
    """

    grazing_rad: float = math.radians(80)
    apart_rad: float = math.radians(5)
    detector_rad: float | None = None

    def allow(self, wi: Tensor, wo: Tensor) -> Tensor:
        """Tell which directions are within the limits, bool [...].

        Args:
            wi: unit vectors to the light, [..., 3].
            wo: unit vectors to the detector, [..., 3].
        """
        is_measurable = torch.minimum(wi[..., 2], wo[..., 2]) >= math.cos(self.grazing_rad) - 1e-6
        result: Tensor = is_measurable & ((wi * wo).sum(-1) <= math.cos(self.apart_rad))
        return result


def places_at_angles(angles: Tensor) -> Tensor:
    """Return half vector, difference vector and cos theta_i, [1, 7, N], of half and difference angles [N, 3] in rad."""
    return half_difference_and_cosine(angles).T[None]


@dataclass(frozen=True)
class Posterior:
    """A material after samples: a fit by the model, and the covariance of its last layer that the samples leave.

    Attributes:
        theta: the fit of one task, [1, ...], or the model's own mean.
        covariance: covariance of the weights of features, for each opponent axis, [3, F, F].
    """

    theta: Params
    covariance: Tensor

    @classmethod
    def from_samples(cls, theta: Params, where: Tensor, slope: Tensor | None = None) -> Posterior:
        """Condition the model on samples.

        Args:
            theta: parameters of one task, [1, ...].
            where: half vector, difference vector and cos theta_i of the samples, [1, 7, N]; N may be 0.
            slope: :func:`error_slope` of the measured reflectance, [1, 3, N]; None: of the reflectance of theta.
        """
        if slope is None:
            slope = error_slope(model_reflectance(theta, where).clamp_min(0), where)
        features = model_features(theta, where)[0].double()
        gram = features * sample_precision(theta, slope)[0].double() @ features.T
        prior = torch.diag_embed(torch.exp(-2 * theta["deviation"][0].double()))
        return cls(theta, torch.cholesky_inverse(torch.linalg.cholesky(gram + prior)))

    def log_deviation(self, where: Tensor) -> Tensor:
        """Return the standard deviation of the logarithm of each channel, [3, N], at `where` [1, 7, N]."""
        features = model_features(self.theta, where)[0].to(self.covariance)
        axis_variances = torch.einsum("fn,cfg,gn->cn", features, self.covariance, features).clamp_min(0)
        result: Tensor = (opponent_axes(axis_variances).square() @ axis_variances).sqrt()
        return result

    def expected_error(self, where: Tensor) -> Tensor:
        """Return the expected error |log(1 + f cos theta_i) - log(1 + f' cos theta_i)|, [N], at `where` [1, 7, N].

        It is the mean over channels.
        """
        slope = error_slope(model_reflectance(self.theta, where).clamp_min(0), where)[0]
        return MEAN_ABSOLUTE_NORMAL * (slope * self.log_deviation(where)).mean(0)


@functools.cache
def spread_places(count: int = 512) -> Tensor:
    """Return half vector, difference vector and cos theta_i, [1, 7, count], of directions that are spread evenly."""
    return places_at_angles(quasirandom_angles(count))


def expected_errors(posterior: Posterior) -> dict[str, float]:
    """Return the expected error over all directions, in highlights, and at grazing angles.

    Highlights are where the half vector is within 10 degrees of the normal; angles are grazing where light or viewer is
    beyond 70 degrees from it.

    Returns:
        `expected`, `expected_highlight` and `expected_grazing`.
    """
    where = spread_places()
    errors = posterior.expected_error(where)
    in_highlight = where[0, 2] > math.cos(math.radians(10))
    is_grazing = torch.minimum(where[0, 6], outgoing_cosine(where)[0]) < math.cos(math.radians(70))
    parts = {"": errors, "_highlight": errors[in_highlight], "_grazing": errors[is_grazing]}
    return {f"expected{part}": float(part_errors.mean()) for part, part_errors in parts.items()}


def plan_directions(
    theta: Params, count: int, limits: InstrumentLimits, seen: Tensor, rng: Generator
) -> tuple[Tensor, Tensor]:
    """Choose the directions to measure next.

    Args:
        theta: the model, or a fit by it, [1, ...].
        count: number of pairs of directions.
        limits: limits of the instrument.
        seen: angles [M, 3] in rad of earlier measurements; M may be 0.
        rng: the source of candidates.

    Returns:
        Unit vectors to light and detector, [count, 3] each, phi_o = 0, the most telling first.

    Raises:
        ValueError: fewer than `count` directions are within the limits.
    """
    candidates = _draw_candidates(limits, rng)
    wi, wo = _to_directions(candidates)
    candidates = candidates[limits.allow(wi, wo)]
    if len(candidates) < count:
        raise ValueError(
            f"{len(candidates)} of {CANDIDATE_PAIRS} pairs of directions within the limits, expected {count} or more; "
            "raise --grazing, or lower --apart or --detector."
        )
    reference_places = spread_places(REFERENCE_PAIRS)
    theta = {key: value.detach() for key, value in theta.items()}
    seen_places = places_at_angles(seen.float())
    with torch.no_grad():
        posterior = Posterior.from_samples(theta, seen_places)
        chosen = candidates[_choose_greedily(theta, posterior, _to_places(candidates), reference_places, count)]
    return _to_directions(_refine(theta, chosen, limits, seen_places, reference_places))


def _draw_candidates(limits: InstrumentLimits, rng: Generator) -> Tensor:
    """Draw candidates, [CANDIDATE_PAIRS, 3] in rad: polar angles of detector and half vector, azimuth between them."""
    draws = torch.rand(CANDIDATE_PAIRS, 3, generator=rng)
    detector = draws[:, 0] * limits.grazing_rad
    if limits.detector_rad is not None:
        detector = torch.full_like(detector, limits.detector_rad)
    return torch.stack([detector, draws[:, 1] ** CROWDING_POWER * math.pi / 2, draws[:, 2] * math.pi], 1)


def _to_directions(candidates: Tensor) -> tuple[Tensor, Tensor]:
    """Return unit vectors to light and detector, [N, 3] each, of candidates [N, 3]."""
    detector, half, azimuth = candidates.unbind(1)
    wo = torch.stack([detector.sin(), torch.zeros_like(detector), detector.cos()], 1)
    h = torch.stack([half.sin() * azimuth.cos(), half.sin() * azimuth.sin(), half.cos()], 1)
    return 2 * (h * wo).sum(1, keepdim=True) * h - wo, wo


def _to_places(candidates: Tensor) -> Tensor:
    """Return half vector, difference vector and cos theta_i, [1, 7, N], of candidates [N, 3]."""
    return places_at_angles(directions_to_full_rusinkiewicz(*_to_directions(candidates)))


def _choose_greedily(
    theta: Params, posterior: Posterior, where: Tensor, reference_places: Tensor, count: int
) -> list[int]:
    """Choose candidates one after the other, each the one by which the expected square error falls most.

    A measurement shrinks the covariance of the model's parameters, whatever its value will be: so the error that is
    expected after it is known before it is made.

    Args:
        theta: the model, or a fit by it, [1, ...].
        posterior: the model after earlier measurements.
        where: candidates as half vector, difference vector and cos theta_i, [1, 7, N].
        reference_places: the pairs of directions whose error is lowered, likewise [1, 7, M].
        count: number of candidates to choose.

    Returns:
        The indices of the chosen candidates, in this order.
    """
    weights = sample_precision(theta, error_slope(model_reflectance(theta, where).clamp_min(0), where))[0].double()
    reference_slope = error_slope(model_reflectance(theta, reference_places).clamp_min(0), reference_places)[0].double()
    features = model_features(theta, where)[0].double()
    reference_features = model_features(theta, reference_places)[0].double() * reference_slope.mean(0)
    reference_gram, covariance = reference_features @ reference_features.T, posterior.covariance
    chosen: list[int] = []
    for _ in range(count):
        covariances = covariance @ features  # of the parameters with each candidate's measurement, [3, F, N]
        variances = 1 / weights + (covariances * features).sum(1)  # of the measurements, with noise
        error_drops = ((reference_gram @ covariances) * covariances).sum(1) / variances
        best = int(error_drops.sum(0).argmax())
        chosen.append(best)
        column = covariances[:, :, best]
        covariance = covariance - column[:, :, None] * column[:, None] / variances[:, best, None, None]
    return chosen


def _refine(
    theta: Params, candidates: Tensor, limits: InstrumentLimits, seen_places: Tensor, reference_places: Tensor
) -> Tensor:
    """Turn candidates by Adam so that the expected error falls, and return the best ones of all steps, [N, 3] in rad.

    A candidate that a step would turn beyond the limits of the instrument stays where it is.

    Args:
        theta: the model, or a fit by it, [1, ...].
        candidates: polar angles of detector and half vector, and the azimuth between, [N, 3] in rad.
        limits: limits of the instrument.
        seen_places: earlier measurements as half vector, difference vector and cos theta_i, [1, 7, M].
        reference_places: the pairs of directions whose error is lowered, likewise [1, 7, K].
    """
    candidates = candidates.clone()
    best, least_error = candidates, math.inf
    moment, square_moment = torch.zeros_like(candidates), torch.zeros_like(candidates)
    is_movable = torch.tensor([limits.detector_rad is None, True, True])
    for step in range(REFINEMENT_STEPS + 1):
        candidates.requires_grad_()
        where = torch.cat([seen_places, _to_places(candidates)], 2)
        error = Posterior.from_samples(theta, where).expected_error(reference_places).mean()
        if error.item() < least_error:
            best, least_error = candidates.detach(), error.item()
        (gradient,) = torch.autograd.grad(error, candidates)
        candidates = candidates.detach()
        moment, square_moment = 0.8 * moment + 0.2 * gradient, 0.95 * square_moment + 0.05 * gradient.square()
        rate_rad = RATE_RAD * (1 - step / (REFINEMENT_STEPS + 1))
        moved = candidates - rate_rad * is_movable * moment / (square_moment.sqrt() + 1e-12)
        moved[:, 0].clamp_(0, limits.grazing_rad)
        candidates = torch.where(limits.allow(*_to_directions(moved))[:, None], moved, candidates)
    return best
