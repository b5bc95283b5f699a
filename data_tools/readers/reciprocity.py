"""The test whether measured reflectance is that of a BRDF, which is the same if light and detector change places.

Radiance under a constant light, and light power at a detector, are a BRDF times the cosine of one direction. Such
tables pass every test of ranges. Their values at pairs of directions that are swapped differ by the ratio of the two
cosines, which fits as a dependence on the azimuth of the half vector, as if the material were anisotropic.
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from data_tools.readers.measured_pairs import MAX_DISTANCES, MeasuredPairs
from metapp.appearance.geometry import directions_to_rusinkiewicz

MAX_COMPARED_PAIRS = 512  # number of measurements, at most, that are compared with their swapped ones
MIN_COMPARED_PAIRS = 12  # number of measurements with a swapped one, below which no cosine is found
MAX_PARTNER_DISTANCE = 0.1  # between a measurement swapped and its nearest one; see `_embed_angles`
MIN_LOG_COSINE_RATIO = 0.1  # of the two detectors, below which a pair says nothing of a cosine
MAX_POWER_ERROR = 0.15  # of the cosine's power, from 1 or -1
MAX_UNEXPLAINED_SHARE = 0.5  # of absolute log differences of swapped pairs, after the cosine is divided out


def require_reciprocity(subject: str | Path, pairs: MeasuredPairs) -> None:
    """Refuse measurements that are a BRDF times, or over, the cosine of one direction.

    Args:
        subject: the file or name that the error names.
        pairs: the measurements, above the surface.

    Raises:
        ValueError: values of swapped pairs of directions differ as a cosine does.
    """
    power, count = fit_cosine_power(pairs)
    if not count:
        return
    multiplied, divided = ("theta_o", "theta_i") if power > 0 else ("theta_i", "theta_o")
    raise ValueError(
        f"{subject}: not reciprocal: {count:,} pairs of directions that are swapped differ as (cos {multiplied})^"
        f"{abs(power):.2f}, expected the BRDF in 1/sr, which is equal for both; it looks like a BRDF times cos "
        f"{multiplied}: divide the values by it (or, if they were divided by cos {divided}, multiply by that)."
    )


def fit_cosine_power(pairs: MeasuredPairs) -> tuple[float, int]:
    """Fit the power of cos theta_o by which reflectance fails to be reciprocal.

    Each measurement is compared with the one that is nearest to it after light and detector are swapped. The material
    is taken as isotropic: only the angles between directions and normal count. The power is fitted to differences of
    log reflectance by least absolute deviations, which lone outliers and noisy highlights do not change much.

    Returns:
        The power, near 1 for a BRDF times cos theta_o and near -1 for one times cos theta_i, and the number of swapped
        pairs; (0, 0) if differences are no such cosine's, or too few pairs are swapped.
    """
    nothing = (0.0, 0)
    is_lit = (pairs.reflectance.mean(1) > 0).nonzero()[:, 0]
    wi, wo, logs = pairs.wi[is_lit], pairs.wo[is_lit], pairs.reflectance[is_lit].mean(1).log()
    if len(wi) < MIN_COMPARED_PAIRS:
        return nothing
    order = torch.randperm(len(wi), generator=torch.Generator().manual_seed(0))[:MAX_COMPARED_PAIRS]
    points, swapped_points = _embed_directions(wi, wo), _embed_directions(wo[order], wi[order])
    nearest = [torch.cdist(part, points).min(1) for part in swapped_points.split(max(1, MAX_DISTANCES // len(points)))]
    distances, partners = (torch.cat(parts) for parts in zip(*nearest, strict=True))
    log_cosines = wo[:, 2].log()
    ratios, differences = log_cosines[order] - log_cosines[partners], logs[order] - logs[partners]
    is_compared = (distances <= MAX_PARTNER_DISTANCE) & (ratios.abs() >= MIN_LOG_COSINE_RATIO)
    ratios, differences = ratios[is_compared], differences[is_compared]
    if len(ratios) < MIN_COMPARED_PAIRS:
        return nothing
    power = _weighted_median(differences / ratios, ratios.abs())
    unexplained = float((differences - power * ratios).abs().sum() / differences.abs().sum().clamp_min(1e-12))
    is_cosine = abs(abs(power) - 1) <= MAX_POWER_ERROR and unexplained <= MAX_UNEXPLAINED_SHARE
    return (power, len(ratios)) if is_cosine else nothing


def _embed_directions(wi: Tensor, wo: Tensor) -> Tensor:
    """Embed pairs of directions, [N, 3] each, so that near points [N, 4] have similar reflectance.

    Unlike the neighbours of :func:`data_tools.readers.measured_pairs.depends_on_azimuth`, light and detector are told
    apart; the mirror images phi_d and -phi_d are not.
    """
    cos_i, cos_o = wi[:, 2], wo[:, 2]
    theta_h, theta_d, _ = directions_to_rusinkiewicz(wi, wo).unbind(1)
    return torch.stack([2 * theta_h.sqrt(), theta_d, cos_i.clamp(-1, 1).acos(), cos_o.clamp(-1, 1).acos()], 1)


def _weighted_median(values: Tensor, weights: Tensor) -> float:
    """Return the median of values [N] of which each counts by its weight [N]."""
    order = values.argsort()
    sums = weights[order].cumsum(0)
    return float(values[order][torch.searchsorted(sums, sums[-1:] / 2)[0]])
