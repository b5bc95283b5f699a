"""Principal components of log-relative reflectance, and ridge regression of coefficients.

After Nielsen et al. 2015, "On Optimal, Minimal BRDF Sampling for Reflectance Acquisition".
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

EPSILON = 1e-3  # as published: what keeps logs finite, and cosines off 0
ROWS = 8192  # that a Gram matrix is summed over at once


class Relative(NamedTuple):
    """The log-relative mapping of reflectance: log((f w + e) / (f0 w + e)).

    Attributes:
        weight: w, the product of both cosines, EPSILON at least, [N, 1].
        reference: f0, the median of training BRDFs, [N, 1] in 1/sr.
    """

    weight: Tensor
    reference: Tensor

    def mapped(self, reflectance: Tensor) -> Tensor:
        """Of reflectance [N, C] in 1/sr."""
        return torch.log((reflectance * self.weight + EPSILON) / (self.reference * self.weight + EPSILON))

    def reflectance(self, mapped: Tensor) -> Tensor:
        """The inverse of `mapped`, at least 0."""
        full = torch.exp(mapped) * (self.reference * self.weight + EPSILON)
        return ((full - EPSILON) / self.weight).clamp_min(0)


class Components(NamedTuple):
    """Principal components, the most important first.

    Attributes:
        mean: of the columns, [N, 1].
        axes: [N, K], orthogonal, each scaled to a root mean square of 1.
        deviation: of the columns along each, [K].
    """

    mean: Tensor
    axes: Tensor
    deviation: Tensor

    def first(self, count: int) -> Components:
        """The most important ones, contiguous."""
        return Components(self.mean, self.axes[:, :count].contiguous(), self.deviation[:count])


def components(columns: Tensor, count: int) -> Components:
    """Principal components of columns [N, C], up to `count`; by their Gram matrix, in double precision.

    Those that vary by less than rounding are left out.
    """
    mean = columns.mean(1, keepdim=True)
    gram = torch.zeros(columns.shape[1], columns.shape[1], dtype=torch.float64)
    for part, middle in zip(columns.split(ROWS), mean.split(ROWS), strict=True):
        centred = (part - middle).double()
        gram += centred.T @ centred
    squared, vectors = torch.linalg.eigh(gram)
    order = torch.arange(len(squared) - 1, -1, -1)[:count]
    order = order[squared[order] > 1e-12 * squared[-1]]
    scale = math.sqrt(len(columns)) / squared[order].sqrt()
    axes = (columns - mean) @ (vectors[:, order] * scale).to(columns)
    return Components(mean, axes, (1 / scale * math.sqrt(1 / columns.shape[1])).to(columns))


def ridge(axes: Tensor, targets: Tensor, weights: Tensor, deviation: Tensor, penalty: float) -> Tensor:
    """Coefficients [K, C] that fit targets [n, C], drawn towards 0 by how little training tasks vary.

    By normal equations; by QR in double precision where rounding would hide that these are positive definite: of fewer
    samples than axes and a small penalty.

    Args:
        axes: [n, K].
        targets: [n, C].
        weights: of the squared residuals, [n, C].
        deviation: of training tasks along the axes, [K].
        penalty: of a coefficient at its deviation.
    """
    drawn, solved = penalty / deviation.double().square(), []
    for target, weight in zip(targets.T, weights.T, strict=True):
        weighted = axes * weight[:, None]
        left = (axes.T @ weighted).double() + torch.diag(drawn)
        factor, failed = torch.linalg.cholesky_ex(left)
        # rounding changes pivots by about this much: smaller ones are made of it, even where the factorisation succeeds
        rounding = torch.finfo(axes.dtype).eps * left.diagonal().sum()
        if failed or factor.diagonal().square().amin() < rounding:
            root = weight.double().sqrt()[:, None]
            q, r = torch.linalg.qr(torch.cat([root * axes, torch.diag(drawn.sqrt())]))
            solution = torch.linalg.solve_triangular(r, q[: len(axes)].T @ (root * target[:, None]), upper=True)
        else:
            solution = torch.cholesky_solve((weighted.T @ target).double()[:, None], factor)
        solved.append(solution[:, 0])
    return torch.stack(solved, 1).to(targets)
