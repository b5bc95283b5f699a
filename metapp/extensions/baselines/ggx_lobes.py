"""A Lambertian body under GGX lobes, fitted by least squares (after Ngan, Durand, Matusik 2005).

Nothing here knows of tasks or of baselines.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import least_squares, nnls
from torch import Tensor

from metapp.appearance.geometry import Cosines
from metapp.appearance.reflection import fresnel_schlick, microfacet_lobe

Floats = NDArray[np.float64]

NUMBERS_PER_LOBE = 5  # log alpha, Schlick's F0, a colour of three channels
INITIAL_ALPHAS = ((0.03, 0.3), (0.1, 0.5))  # alphas of two lobes at which descents begin
INITIALISATION_SAMPLES = 1024  # samples of the short descents of which the best is continued
MIN_ALPHA, MAX_ALPHA = 0.005, 1.5  # bounds of the GGX alpha of a lobe
SQUARED_ERROR_BOUND = 0.003  # errors below it count by their squares, errors above it by their absolute values
LOG_ALPHA_STEP = 1e-5  # of finite differences: forward-mode differentiation takes ten times as long
STOPPING_TOLERANCE = 1e-5  # relative change of the numbers or of the cost at which a descent stops


def lobes_reflectance(numbers: Tensor, cosines: Cosines) -> Tensor:
    """Return the BRDF of a Lambertian body under L GGX lobes.

    Args:
        numbers: [3 + 5 L], the colour of the body, then for each lobe log alpha, F0 and a colour.
        cosines: the cosines of the samples, [n] each.

    Returns:
        The BRDF, [n, 3] in 1/sr.
    """
    body, lobes = numbers[:3], numbers[3:].reshape(-1, NUMBERS_PER_LOBE)
    reflectance = (body / math.pi).expand(*cosines.half.shape, 3)
    for lobe in lobes.unbind():
        reflectance = (
            reflectance
            + (_evaluate_lobe(lobe[0], cosines) * fresnel_schlick(cosines.difference, lobe[1]))[:, None] * lobe[2:]
        )
    return reflectance


def lobes_jacobian(numbers: Tensor, cosines: Cosines) -> Tensor:
    """Return the derivatives of :func:`lobes_reflectance` by its numbers.

    Args:
        numbers: [3 + 5 L], the colour of the body, then for each lobe log alpha, F0 and a colour.
        cosines: the cosines of the samples, [n] each.

    Returns:
        The derivatives, [n, 3, 3 + 5 L].
    """
    derivatives = torch.zeros(len(cosines.half), 3, len(numbers), dtype=numbers.dtype)
    channels = torch.arange(3)
    derivatives[:, channels, channels] = 1 / math.pi
    for i, lobe in enumerate(numbers[3:].reshape(-1, NUMBERS_PER_LOBE).unbind()):
        first = 3 + NUMBERS_PER_LOBE * i
        shape = _evaluate_lobe(lobe[0], cosines)
        shape_above, shape_below = (
            _evaluate_lobe(lobe[0] + step, cosines) for step in (LOG_ALPHA_STEP, -LOG_ALPHA_STEP)
        )
        shape_slope = (shape_above - shape_below) / (2 * LOG_ALPHA_STEP)
        fresnel = fresnel_schlick(cosines.difference, lobe[1])
        derivatives[:, :, first] = (shape_slope * fresnel)[:, None] * lobe[2:]
        derivatives[:, :, first + 1] = (shape * (1 - fresnel_schlick(cosines.difference, 0.0)))[:, None] * lobe[2:]
        derivatives[:, channels, first + 2 + channels] = (shape * fresnel)[:, None]
    return derivatives


def _evaluate_lobe(log_alpha: Tensor, cosines: Cosines) -> Tensor:
    """Return the values [n] of a white GGX lobe whose Fresnel reflectance is 1."""
    return microfacet_lobe(cosines, log_alpha.exp(), torch.ones_like)[..., 0]


def fit_ggx_lobes(
    cosines: Cosines, target: Tensor, initial_alphas: tuple[tuple[float, ...], ...] = INITIAL_ALPHAS
) -> Tensor:
    """Fit the numbers of a body and lobes to samples; absolute errors count, except that small ones count by squares.

    Args:
        cosines: the cosines of the samples, [n] each, float64.
        target: log(1 + f cos theta_i), [n, 3], float64.
        initial_alphas: for each descent the alphas of the lobes at which it begins; the best descent is continued on
            all samples.

    Returns:
        The numbers [3 + 5 L] that :func:`lobes_reflectance` takes, float64.
    """
    subset = Cosines(*(cosine[:INITIALISATION_SAMPLES] for cosine in cosines)), target[:INITIALISATION_SAMPLES]
    descents = [_descend(*subset, _initialise_numbers(*subset, alphas)) for alphas in initial_alphas]
    numbers = min(descents, key=lambda descent: descent[1])[0]
    return torch.from_numpy(_descend(cosines, target, numbers)[0])


def _descend(cosines: Cosines, target: Tensor, initial_numbers: Floats) -> tuple[Floats, float]:
    """Descend from initial numbers, and return the numbers found and their cost."""
    cos = cosines.incident[:, None]

    def compute_residuals(values: Floats) -> Floats:
        return (torch.log1p(lobes_reflectance(torch.from_numpy(values), cosines) * cos) - target).numpy().ravel()

    def compute_jacobian(values: Floats) -> Floats:
        numbers = torch.from_numpy(values)
        chain_factor = cos / (1 + lobes_reflectance(numbers, cosines) * cos)
        return (lobes_jacobian(numbers, cosines) * chain_factor[..., None]).flatten(0, 1).numpy()

    lobe_count = (len(initial_numbers) - 3) // NUMBERS_PER_LOBE
    low = np.array([0.0] * 3 + [math.log(MIN_ALPHA), 0.0, 0.0, 0.0, 0.0] * lobe_count)
    bounds = low, np.array([np.inf] * 3 + [math.log(MAX_ALPHA), 1.0, np.inf, np.inf, np.inf] * lobe_count)
    solution = least_squares(
        compute_residuals,
        np.clip(initial_numbers, *bounds),
        jac=compute_jacobian,
        bounds=bounds,
        x_scale="jac",
        loss="soft_l1",
        f_scale=SQUARED_ERROR_BOUND,
        ftol=STOPPING_TOLERANCE,
        xtol=STOPPING_TOLERANCE,
        max_nfev=60,
    )
    return solution.x, float(solution.cost)


def _initialise_numbers(cosines: Cosines, target: Tensor, alphas: tuple[float, ...]) -> Floats:
    """Return numbers at which a descent begins: colours, at least 0, that fit best at given alphas and F0 = 0.04."""
    lobes = [torch.full_like(cosines.half, 1 / math.pi)]
    fresnel = fresnel_schlick(cosines.difference, 0.04)
    lobes += [_evaluate_lobe(torch.tensor(math.log(alpha), dtype=torch.float64), cosines) * fresnel for alpha in alphas]
    cos_incident = cosines.incident
    columns = torch.stack(lobes, 1) * cos_incident[:, None]
    solutions = []
    for channel in target.unbind(1):
        weight = torch.exp(-channel)[:, None]  # the derivative of log(1 + x)
        solutions.append(nnls((columns * weight).numpy(), (channel.expm1() * weight[:, 0]).numpy())[0])
    colours = np.stack(solutions, 1) + 1e-4
    return np.concatenate([colours[0], *([math.log(a), 0.04, *c] for a, c in zip(alphas, colours[1:], strict=True))])
