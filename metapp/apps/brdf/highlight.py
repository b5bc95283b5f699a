"""The height of the highlight where few samples show it: what they carry, by which fits are held, and a line in doubt.

Features that were learned on measured materials rise towards mirror directions, and between few samples nothing keeps
them from it. Smooth lobes of many widths, which only add up, cannot rise so: their sum is determined by samples beside
the peak. Neither knows a peak that is narrower than the distance to the nearest sample. So a fit far above the lobes is
left as it is, and a line says at which angles it is a guess.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import nnls
from torch import Tensor

from metapp.appearance.geometry import (
    half_difference_and_cosine,
    is_above_horizon,
    outgoing_cosine,
    quasirandom_angles,
)
from metapp.apps.brdf.energy import CROWDING_POWER, RELATIVE_RIDGE, judged_slope

MIRROR_DEGREES = 5  # degrees between half vector and normal, up to which a sample shows the highlight
MANY_SAMPLES = 4096  # different samples, from which on they show a highlight everywhere, and penalties count no less
LOBE_WIDTHS_RAD = np.geomspace(0.03, 0.9, 9)  # about the angle at which a lobe has fallen to a third of its peak
LOBE_RIDGE = 1e-3  # the penalty of lobes, over the deviation of their values
MATTE_REFLECTANCE = 0.01  # 1/sr that is added to reflectance before ratios are formed: black matter has no highlight
NEAREST_SAMPLES = 8  # samples nearest to mirror directions, which lobes that are too low there are scaled by
HELD_PLACES = 1024  # pairs of directions where fits are held
LEAST_COSINE = 0.02  # of light and viewer where fits are held
MIRROR_RAD = torch.arange(0, 76, 5).deg2rad()  # angles of the light whose mirror directions are compared
# chosen on drawn Ward, Phong, Beckmann and mixed lobes and on fits of measured materials, 300 to 4,000 scattered pairs
MAX_HELD_EXCESS = 5.0  # fit over lobes, above which it may be a peak that no sample shows
HELD_SOLVES, HELD_TOLERANCE = 3, 0.05  # solves, and the excess of log(1 + f) that needs none
SMOOTHING = 5e-4  # of |d| in the weights of samples, as rules learn it
MAX_SILENT_RATIO = 1.3  # greatest over least height that samples allow, above which a line says so


def mirror_places() -> Tensor:
    """Return the mirror directions of light from MIRROR_RAD, [1, 7, 16], as networks read them."""
    zeros = torch.zeros_like(MIRROR_RAD)
    return half_difference_and_cosine(torch.stack([zeros, MIRROR_RAD, zeros], 1)).T[None]


@functools.cache
def held_places() -> Tensor:
    """Return pairs of directions that crowd around highlights, [1, 7, N], as networks read them."""
    angles = quasirandom_angles(HELD_PLACES)
    angles[:, 0] = (angles[:, 0] / (math.pi / 2)) ** CROWDING_POWER * math.pi / 2
    where = half_difference_and_cosine(angles[is_above_horizon(angles)]).T[None]
    return where[:, :, least_cosine(where[0]) > LEAST_COSINE]


def least_cosine(where: Tensor) -> Tensor:
    """Return the lesser of cos theta_i and cos theta_o, [N], at `where` [7, N]."""
    return torch.minimum(where[6], outgoing_cosine(where[None])[0])


def half_angles(where: Tensor) -> Tensor:
    """Return theta_h in rad, [N], at `where` [7, N]."""
    return torch.atan2(torch.hypot(where[0], where[1]), where[2])


def lobe_values(where: Tensor) -> NDArray[np.float64]:
    """Return a matte body's and lobes' reflectance, [N, 2 + 6 x widths] in 1/sr.

    The body is even or brighter at grazing angles. A lobe of a width has the shape of GGX or of Beckmann. It is even,
    masked and shadowed as of GGX, or that with Schlick's Fresnel factor.

    Args:
        where: half vector, difference vector and cos theta_i, [7, N].
    """
    incident, outgoing, half, difference = (
        values.double().numpy() for values in (where[6], outgoing_cosine(where[None])[0], where[2], where[5])
    )
    half = half.clip(1e-3, 1)
    fresnel, slope_square = (1 - difference.clip(0, 1)) ** 5, (1 - half**2) / half**2
    columns = [np.full_like(half, 1 / math.pi), fresnel / math.pi]
    for width in LOBE_WIDTHS_RAD:
        masked = [2 * c / (c + np.sqrt(width**2 + (1 - width**2) * c**2)) for c in (incident, outgoing)]
        geometry = masked[0] * masked[1] / np.maximum(4 * incident * outgoing, 1e-3)
        ggx = width**2 / (math.pi * ((width**2 - 1) * half**2 + 1) ** 2)
        beckmann = np.exp(-slope_square / width**2) / (math.pi * width**2 * half**4)
        for density in (ggx, beckmann):
            # the constants make columns about equally large
            columns += [0.04 * density * geometry, density * geometry * fresnel, density / 20]
    return np.stack(columns, 1)


def fit_lobes(where: Tensor, reflectance: Tensor, least_width_rad: float) -> NDArray[np.float64]:
    """Return the weights [C, columns] of :func:`lobe_values`, at least 0, by least squares near the error of fits.

    Args:
        where: half vector, difference vector and cos theta_i of the samples, [7, N].
        reflectance: their reflectance in 1/sr, [C, N].
        least_width_rad: the least width of lobes that are used.
    """
    widths = np.concatenate([[math.inf] * 2, np.repeat(LOBE_WIDTHS_RAD, 6)])
    used, columns = widths >= least_width_rad, lobe_values(where)
    columns, cosine, weights = columns[:, used], where[6].double().numpy(), np.zeros((len(reflectance), len(widths)))
    for channel, values in enumerate(reflectance.double().numpy()):
        # the derivative of log(1 + f cos theta_i) in f
        slope = cosine / (1 + values * cosine) / math.sqrt(len(values))
        matrix = columns * slope[:, None]
        ridge = LOBE_RIDGE * matrix.std() * np.eye(matrix.shape[1])
        target = np.concatenate([values * slope, np.zeros(len(ridge))])
        weights[channel, used] = nnls(np.concatenate([matrix, ridge]), target, maxiter=3000)[0]
    return weights


def evaluate_lobes(weights: NDArray[np.float64], where: Tensor) -> Tensor:
    """Return the reflectance of lobes, [C, N] in 1/sr, float64, of weights [C, columns] at `where` [7, N]."""
    return torch.from_numpy(weights @ lobe_values(where).T)


def excess(above: Tensor, below: Tensor) -> float:
    """Return the greatest ratio of two reflectances [..., N] in 1/sr, of which MATTE_REFLECTANCE does not count."""
    return float(((above + MATTE_REFLECTANCE) / (below + MATTE_REFLECTANCE)).amax())


def hold_last_layer(features: Callable[[Tensor], Tensor], last: Tensor, where: Tensor, target: Tensor) -> Tensor:
    """Return a last layer close to the given one whose highlight rises no higher than samples beside it carry.

    What samples carry are lobes at least as wide as the nearest sample is far from mirror directions. They are raised
    until none of the NEAREST_SAMPLES is above them. The layer is unchanged if no sample is within MIRROR_DEGREES, and
    if the fit is above the lobes by more than MAX_HELD_EXCESS: it may then be a peak that samples do not show.

    Args:
        features: a function from `where` [1, 7, N] to features [F, N]; log(1 + f) is their sum, weighted by the layer.
        last: the layer, [3, F].
        where: half vector, difference vector and cos theta_i of the samples, [7, N].
        target: log(1 + f cos theta_i) of the samples, [3, N].
    """
    where, theta_h, cosine = where.cpu(), half_angles(where.cpu()), where[6].double().cpu()
    reflectance = target.double().cpu().expm1() / cosine.clamp_min(1e-4)
    if float(theta_h.amin()) > math.radians(MIRROR_DEGREES) or not last.isfinite().all():
        return last
    lobes, layer = fit_lobes(where, reflectance, float(theta_h.amin())), last.double().cpu()
    mirror, places = mirror_places(), held_places()
    fitted_peak = torch.expm1(layer @ features(mirror).double().cpu()).clamp_min(0).mean(0)
    if excess(fitted_peak, evaluate_lobes(lobes, mirror[0]).mean(0)) > MAX_HELD_EXCESS:
        return last
    nearest = theta_h.argsort()[:NEAREST_SAMPLES]
    shortfall = excess(reflectance[:, nearest].mean(0), evaluate_lobes(lobes, where[:, nearest]).mean(0))
    limit = torch.log1p(evaluate_lobes(lobes, places[0]) * max(1.0, shortfall))
    # beyond the angles that samples reach, lobes know no more than the fit
    limit[:, least_cosine(places[0]) < least_cosine(where).amin()] = math.inf
    sample_features, place_features = (features(pairs).double().cpu() for pairs in (where[None], places))
    logs, slope = reflectance.log1p(), judged_slope(reflectance, cosine)
    for _ in range(HELD_SOLVES):
        fitted = layer @ place_features
        if (fitted <= limit + HELD_TOLERANCE).all():
            break
        held, residual = torch.minimum(fitted, limit), logs - layer @ sample_features
        held_slope = judged_slope(held.clamp_min(0).expm1(), places[0, 6].double())
        weights = slope.square().mean(0) / ((slope * residual).square().mean(0) + SMOOTHING**2).sqrt() / len(cosine)
        held_weights = held_slope.square().mean(0) / held.shape[1]
        gram = sample_features * weights @ sample_features.T + place_features * held_weights @ place_features.T
        moment = residual * weights @ sample_features.T + (held - fitted) * held_weights @ place_features.T
        gram = gram + RELATIVE_RIDGE * gram.diagonal().mean() * torch.eye(len(gram)).to(gram)
        layer = layer + torch.linalg.solve(gram, moment.T).T
    return layer.to(last)


def describe_unseen_highlight(angles: Tensor) -> str:
    """Return a clause of a note, that no sample that a fit sees shows the highlight; "" if one does.

    Without such a sample the height of the highlight is a guess, which the error on other samples does not show.

    Args:
        angles: theta_h first, [N, 3 or 4] in rad, of the samples that a fit sees.

    >>> describe_unseen_highlight(torch.tensor([[0.3, 0.1, 0.0]])).partition("; ")[0]
    'highlight: no sample within 5 degrees of mirror directions, the nearest at 17'
    >>> describe_unseen_highlight(torch.tensor([[0.01, 0.1, 0.0]]))
    ''
    """
    nearest = math.degrees(float(angles[:, 0].amin()))
    if nearest <= MIRROR_DEGREES:
        return ""
    return (
        f"highlight: no sample within {MIRROR_DEGREES} degrees of mirror directions, the nearest at {nearest:.0f}; its "
        "height is a guess from training materials"
    )


def describe_guessed_highlight(angles: Tensor, reflectance: Tensor, evaluate: Callable[[Tensor], Tensor]) -> str:
    """Return a clause of a note, at which angles the height of the highlight is a guess; "" if samples determine it.

    Samples are explained by lobes twice: by ones that may be twice as narrow as the nearest sample is far from mirror
    directions, and by ones that are wider than the third is far. Where these and the fit differ by more than
    MAX_SILENT_RATIO, samples do not tell.

    Args:
        angles: theta_h, theta_d and phi_d, [N, 3] in rad, of the samples that a fit sees.
        reflectance: their reflectance in 1/sr, [N, 3].
        evaluate: the fit, a function from angles [M, 3] in rad to reflectance [M, 3] in 1/sr.
    """
    if clause := describe_unseen_highlight(angles):
        return clause
    where, theta_h = half_difference_and_cosine(angles).T, angles[:, 0].sort().values
    grey, mirror = reflectance.mean(1)[None], mirror_places()[0]
    widths = 0.5 * float(theta_h[0]), 1.4 * float(theta_h[:3][-1])
    allowed = torch.stack([evaluate_lobes(fit_lobes(where, grey, width), mirror)[0] for width in widths])
    zeros = torch.zeros_like(MIRROR_RAD)
    fitted = evaluate(torch.stack([zeros, MIRROR_RAD, zeros], 1)).double().mean(1)
    heights = torch.cat([allowed, fitted[None]]) + MATTE_REFLECTANCE
    ratios = heights.amax(0) / heights.amin(0)
    if not (guessed := ratios > MAX_SILENT_RATIO).any():
        return ""
    guessed_degrees, worst = MIRROR_RAD[guessed].rad2deg(), int(ratios.argmax())
    least, greatest = allowed[:, worst].sort().values.tolist()
    return (
        f"highlight: its height is a guess for light from {guessed_degrees[0]:.0f} to {guessed_degrees[-1]:.0f} "
        f"degrees, {float(fitted[worst]):.3g} /sr at {MIRROR_RAD[worst].rad2deg():.0f}, where samples allow "
        f"{least:.3g} to {greatest:.3g}; measure more near mirror directions"
    )
