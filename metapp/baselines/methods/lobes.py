"""A Lambertian body under GGX lobes, fitted by least squares (after Ngan, Durand, Matusik 2005)."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
import torch
from scipy.optimize import least_squares, nnls
from torch import Tensor

from metapp.appearance.geometry import Cosines
from metapp.appearance.reflection import fresnel_schlick, microfacet_lobe

LOBE = 5  # numbers of one: log alpha, Schlick's F0, a colour
STARTS = {1: ((0.03,), (0.12,), (0.4,)), 2: ((0.03, 0.3), (0.1, 0.5))}  # alphas that fits begin at, by lobes
FEW = 1024  # samples of the fits that choose where to begin
NARROWEST, WIDEST = 0.005, 1.5
SMALL = 0.003  # errors below it count as squares, those above as they are
STEP = 1e-5  # of log alpha, for its slope: forward differentiation takes ten times as long
ENOUGH = 1e-5  # of change, of numbers and of the cost, to stop at


class Seen(NamedTuple):
    """Samples in double precision.

    Attributes:
        at: cosines [n].
        target: log(1 + f cos theta_i), [n, 3].
    """

    at: Cosines
    target: Tensor


def reflectance(numbers: Tensor, at: Cosines) -> Tensor:
    """BRDF [n, 3] in 1/sr of 3 + 5 L numbers: the body's colour, then for each lobe log alpha, F0 and a colour."""
    body, rest = numbers[:3], numbers[3:].reshape(-1, LOBE)
    total = (body / math.pi).expand(*at.half.shape, 3)
    for lobe in rest.unbind():
        total = total + (_shape(lobe[0], at) * fresnel_schlick(at.difference, lobe[1]))[:, None] * lobe[2:]
    return total


def slopes(numbers: Tensor, at: Cosines) -> Tensor:
    """Derivatives [n, 3, 3 + 5 L] of `reflectance` by the numbers."""
    found = torch.zeros(len(at.half), 3, len(numbers), dtype=numbers.dtype)
    channels = torch.arange(3)
    found[:, channels, channels] = 1 / math.pi
    for i, lobe in enumerate(numbers[3:].reshape(-1, LOBE).unbind()):
        first = 3 + LOBE * i
        shape = _shape(lobe[0], at)
        steeper = (_shape(lobe[0] + STEP, at) - _shape(lobe[0] - STEP, at)) / (2 * STEP)
        fresnel = fresnel_schlick(at.difference, lobe[1])
        found[:, :, first] = (steeper * fresnel)[:, None] * lobe[2:]
        found[:, :, first + 1] = (shape * (1 - fresnel_schlick(at.difference, 0.0)))[:, None] * lobe[2:]
        found[:, channels, first + 2 + channels] = (shape * fresnel)[:, None]
    return found


def _shape(log_alpha: Tensor, at: Cosines) -> Tensor:
    """A lobe [n] that reflects all it gets."""
    return microfacet_lobe(at, log_alpha.exp(), torch.ones_like)[..., 0]


def fit(seen: Seen, lobes: int) -> Tensor:
    """The numbers of a fit, float64; absolute errors of log(1 + f cos theta_i) count."""
    few = Seen(Cosines(*(each[:FEW] for each in seen.at)), seen.target[:FEW])
    tried = [_descend(few, _first(few, alphas)) for alphas in STARTS[lobes]]
    best = min(tried, key=lambda found: found[1])[0]
    return torch.from_numpy(_descend(seen, best)[0])


def _descend(seen: Seen, first: np.ndarray) -> tuple[np.ndarray, float]:
    """Numbers after a descent, and their cost."""
    cos = seen.at.incident[:, None]

    def residual(x: np.ndarray) -> np.ndarray:
        found: np.ndarray = (torch.log1p(reflectance(torch.from_numpy(x), seen.at) * cos) - seen.target).numpy().ravel()
        return found

    def slopes_of(x: np.ndarray) -> np.ndarray:
        numbers = torch.from_numpy(x)
        outer = cos / (1 + reflectance(numbers, seen.at) * cos)
        found: np.ndarray = (slopes(numbers, seen.at) * outer[..., None]).flatten(0, 1).numpy()
        return found

    low, high = _bounds(len(first))
    found = least_squares(
        residual,
        np.clip(first, low, high),
        jac=slopes_of,
        bounds=(low, high),
        x_scale="jac",
        loss="soft_l1",
        f_scale=SMALL,
        ftol=ENOUGH,
        xtol=ENOUGH,
        max_nfev=60,
    )
    return found.x, float(found.cost)


def _bounds(size: int) -> tuple[np.ndarray, np.ndarray]:
    lobe_low, lobe_high = [math.log(NARROWEST), 0.0, *[0.0] * 3], [math.log(WIDEST), 1.0, *[np.inf] * 3]
    lobes = (size - 3) // LOBE
    return np.array([0.0] * 3 + lobe_low * lobes), np.array([np.inf] * 3 + lobe_high * lobes)


def _first(seen: Seen, alphas: tuple[float, ...]) -> np.ndarray:
    """Where a descent begins: colours that fit best at these alphas and F0 = 0.04, none below 0."""
    shapes = [torch.full_like(seen.at.half, 1 / math.pi)]
    fresnel = fresnel_schlick(seen.at.difference, 0.04)
    shapes += [_shape(torch.tensor(math.log(alpha), dtype=torch.float64), seen.at) * fresnel for alpha in alphas]
    cos = seen.at.incident
    columns = torch.stack(shapes, 1) * cos[:, None]
    found = []
    for target in seen.target.unbind(1):
        weight = torch.exp(-target)[:, None]  # the slope of the log
        found.append(nnls((columns * weight).numpy(), (target.expm1() * weight[:, 0]).numpy())[0])
    colours = np.stack(found, 1) + 1e-4
    return np.concatenate([colours[0], *([math.log(a), 0.04, *c] for a, c in zip(alphas, colours[1:], strict=True))])


@functools.cache
def count(lobes: int) -> int:
    """How many numbers a material takes."""
    return 3 + LOBE * lobes
