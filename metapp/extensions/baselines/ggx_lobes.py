"""A Lambertian body under GGX lobes, fitted by least squares (after Ngan, Durand, Matusik 2005)."""

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

NUMBERS_PER_LOBE = 5  # numbers of one: log alpha, Schlick's F0, a colour
INITIAL_ALPHAS = ((0.03, 0.3), (0.1, 0.5))  # of two lobes, at which fits begin
INITIALISATION_SAMPLES = 1024  # samples of the fits that choose where to begin
MIN_ALPHA, MAX_ALPHA = 0.005, 1.5
SQUARED_ERROR_BOUND = 0.003  # errors below it count as squares, those above as they are
LOG_ALPHA_STEP = 1e-5  # of log alpha, for its slope: forward differentiation takes ten times as long
STOPPING_TOLERANCE = 1e-5  # of change, of numbers and of the cost, to stop at


def lobes_reflectance(numbers: Tensor, cosines: Cosines) -> Tensor:
    """BRDF [n, 3] in 1/sr of 3 + 5 L numbers: the body's colour, then for each lobe log alpha, F0 and a colour."""
    body, rest = numbers[:3], numbers[3:].reshape(-1, NUMBERS_PER_LOBE)
    total = (body / math.pi).expand(*cosines.half.shape, 3)
    for lobe in rest.unbind():
        total = total + (_shape(lobe[0], cosines) * fresnel_schlick(cosines.difference, lobe[1]))[:, None] * lobe[2:]
    return total


def lobes_jacobian(numbers: Tensor, cosines: Cosines) -> Tensor:
    """Derivatives [n, 3, 3 + 5 L] of `lobes_reflectance` by the numbers."""
    derivatives = torch.zeros(len(cosines.half), 3, len(numbers), dtype=numbers.dtype)
    channels = torch.arange(3)
    derivatives[:, channels, channels] = 1 / math.pi
    for i, lobe in enumerate(numbers[3:].reshape(-1, NUMBERS_PER_LOBE).unbind()):
        first = 3 + NUMBERS_PER_LOBE * i
        shape = _shape(lobe[0], cosines)
        up, down = (_shape(lobe[0] + step, cosines) for step in (LOG_ALPHA_STEP, -LOG_ALPHA_STEP))
        steeper = (up - down) / (2 * LOG_ALPHA_STEP)
        fresnel = fresnel_schlick(cosines.difference, lobe[1])
        derivatives[:, :, first] = (steeper * fresnel)[:, None] * lobe[2:]
        derivatives[:, :, first + 1] = (shape * (1 - fresnel_schlick(cosines.difference, 0.0)))[:, None] * lobe[2:]
        derivatives[:, channels, first + 2 + channels] = (shape * fresnel)[:, None]
    return derivatives


def _shape(log_alpha: Tensor, cosines: Cosines) -> Tensor:
    """A lobe [n] that reflects all it gets."""
    return microfacet_lobe(cosines, log_alpha.exp(), torch.ones_like)[..., 0]


def fit_ggx_lobes(cosines: Cosines, target: Tensor, begin: tuple[tuple[float, ...], ...] = INITIAL_ALPHAS) -> Tensor:
    """The numbers of a fit, float64; absolute errors count.

    Args:
        cosines: of the samples, [n], float64.
        target: log(1 + f cos theta_i), [n, 3], float64.
        begin: alphas of the lobes, at each of which a descent begins; the best goes on.
    """
    few = Cosines(*(cosine[:INITIALISATION_SAMPLES] for cosine in cosines)), target[:INITIALISATION_SAMPLES]
    fits = [_descend(*few, _first(*few, alphas)) for alphas in begin]
    best = min(fits, key=lambda fit: fit[1])[0]
    return torch.from_numpy(_descend(cosines, target, best)[0])


def _descend(cosines: Cosines, target: Tensor, first: Floats) -> tuple[Floats, float]:
    """Numbers after a descent, and their cost."""
    cos = cosines.incident[:, None]

    def residual(x: Floats) -> Floats:
        return (torch.log1p(lobes_reflectance(torch.from_numpy(x), cosines) * cos) - target).numpy().ravel()

    def slopes_of(x: Floats) -> Floats:
        numbers = torch.from_numpy(x)
        outer = cos / (1 + lobes_reflectance(numbers, cosines) * cos)
        return (lobes_jacobian(numbers, cosines) * outer[..., None]).flatten(0, 1).numpy()

    lobes = (len(first) - 3) // NUMBERS_PER_LOBE
    low = np.array([0.0] * 3 + [math.log(MIN_ALPHA), 0.0, 0.0, 0.0, 0.0] * lobes)
    bounds = low, np.array([np.inf] * 3 + [math.log(MAX_ALPHA), 1.0, np.inf, np.inf, np.inf] * lobes)
    solution = least_squares(
        residual,
        np.clip(first, *bounds),
        jac=slopes_of,
        bounds=bounds,
        x_scale="jac",
        loss="soft_l1",
        f_scale=SQUARED_ERROR_BOUND,
        ftol=STOPPING_TOLERANCE,
        xtol=STOPPING_TOLERANCE,
        max_nfev=60,
    )
    return solution.x, float(solution.cost)


def _first(cosines: Cosines, target: Tensor, alphas: tuple[float, ...]) -> Floats:
    """The initialisation of a descent: colours that fit best at these alphas and F0 = 0.04, none below 0."""
    shapes = [torch.full_like(cosines.half, 1 / math.pi)]
    fresnel = fresnel_schlick(cosines.difference, 0.04)
    shapes += [_shape(torch.tensor(math.log(alpha), dtype=torch.float64), cosines) * fresnel for alpha in alphas]
    cos = cosines.incident
    columns = torch.stack(shapes, 1) * cos[:, None]
    solutions = []
    for channel in target.unbind(1):
        weight = torch.exp(-channel)[:, None]  # the slope of the log
        solutions.append(nnls((columns * weight).numpy(), (channel.expm1() * weight[:, 0]).numpy())[0])
    colours = np.stack(solutions, 1) + 1e-4
    return np.concatenate([colours[0], *([math.log(a), 0.04, *c] for a, c in zip(alphas, colours[1:], strict=True))])
