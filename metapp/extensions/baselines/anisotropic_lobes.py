"""A Lambertian body under GGX lobes of two roughnesses along axes of their own, fitted by least squares."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from metapp.appearance.reflection import fresnel_schlick
from metapp.apps.brdf.anisotropic import axes_of
from metapp.extensions.baselines.lobes import FEW, NARROWEST, WIDEST, Floats, descended

LOBE = 7  # numbers of one: logs of both roughnesses, azimuth of the first, Schlick's F0, a colour
ALPHAS = {1: (((0.1, 0.03),), ((0.4, 0.1),)), 2: (((0.15, 0.04), (0.4, 0.4)), ((0.3, 0.1), (0.1, 0.3)))}


class Pairs(NamedTuple):
    """Directions in double precision.

    Attributes:
        half: vector [n, 3].
        light, viewer: [n, 3].
    """

    half: Tensor
    light: Tensor
    viewer: Tensor


def pairs_of(where: Tensor) -> Pairs:
    """Of half vector, difference vector in its frame and cos theta_i, [n, 7]."""
    half_x, half_y, half_z, x, y, z, _ = where.double().unbind(-1)
    sine = torch.hypot(half_x, half_y)
    above = sine > 1e-9
    cos_phi, sin_phi = torch.where(above, half_x / sine, 1.0), torch.where(above, half_y / sine, 0.0)

    def out_of_frame(x: Tensor, y: Tensor) -> Tensor:
        along = half_z * x + sine * z
        return torch.stack([cos_phi * along - sin_phi * y, sin_phi * along + cos_phi * y, half_z * z - sine * x], -1)

    return Pairs(torch.stack([half_x, half_y, half_z], -1), out_of_frame(x, y), out_of_frame(-x, -y))


def reflectance(numbers: Tensor, pairs: Pairs) -> Tensor:
    """BRDF [n, 3] in 1/sr of 3 + 7 L numbers: the body's colour, then of each lobe what LOBE lists."""
    total = (numbers[:3] / math.pi).expand(len(pairs.half), 3)
    cos_d = (pairs.light * pairs.half).sum(-1)
    for lobe in numbers[3:].reshape(-1, LOBE).unbind():
        total = total + (_shape(lobe[:3], pairs) * fresnel_schlick(cos_d, lobe[3]))[:, None] * lobe[4:]
    return total


def _shape(lobe: Tensor, pairs: Pairs) -> Tensor:
    """A lobe [n] that reflects all it gets."""
    (first, second), cosine, sine = lobe[:2].exp(), lobe[2].cos(), lobe[2].sin()
    stretched = []
    for vectors in pairs:
        x, y, z = vectors.unbind(-1)
        stretched.append((cosine * x + sine * y, cosine * y - sine * x, z))
    (half_x, half_y, half_z), *directions = stretched
    spread = (half_x / first) ** 2 + (half_y / second) ** 2 + half_z**2
    shape: Tensor = 1 / (math.pi * first * second * spread * spread) / 4
    for x, y, z in directions:
        cos = z.clamp_min(1e-6)
        shape = shape * 2 / (cos + ((first * x) ** 2 + (second * y) ** 2 + cos * cos).sqrt())
    return shape


def fit(where: Tensor, target: Tensor, lobes: int) -> Tensor:
    """The numbers of a fit, float64; absolute errors of log(1 + f cos theta_i) count.

    Args:
        where: half vector, difference vector and cos theta_i, [n, 7].
        target: log(1 + f cos theta_i), [n, 3].
        lobes: how many, 1 or 2.
    """
    turn = float(axes_of({"where": where.T[None], "target": target.T[None]}))
    mean = target.double().expm1().mean(0).numpy()
    starts = []
    for alphas in ALPHAS[lobes]:
        first_lobes = [np.array([math.log(first), math.log(second), turn, 0.1, *mean]) for first, second in alphas]
        starts.append(np.concatenate([mean, *first_lobes]))
    few = [_descend(where[:FEW], target[:FEW], start) for start in starts]
    return torch.from_numpy(_descend(where, target, min(few, key=lambda found: found[1])[0])[0])


def _descend(where: Tensor, target: Tensor, first: Floats) -> tuple[Floats, float]:
    """Numbers after a descent, and their cost."""
    residual = functools.partial(_residual, pairs_of(where), where[:, 6:].double(), target.double())
    lobe_low, lobe_high = [math.log(NARROWEST)] * 2 + [-np.inf, 0.0], [math.log(WIDEST)] * 2 + [np.inf, 1.0]
    count = (len(first) - 3) // LOBE
    low = np.array([0.0] * 3 + [*lobe_low, 0.0, 0.0, 0.0] * count)
    high = np.array([np.inf] * 3 + [*lobe_high, np.inf, np.inf, np.inf] * count)
    return descended(residual, first, (low, high))


def _residual(pairs: Pairs, cos: Tensor, target: Tensor, x: Floats) -> Floats:
    """Errors [3 n]."""
    values = torch.log1p(reflectance(torch.from_numpy(x), pairs) * cos) - target
    result: Floats = values.numpy().ravel()
    return result
