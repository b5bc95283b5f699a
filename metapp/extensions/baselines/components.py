"""Principal components of log-relative reflectance, and coefficients by weighted ridge regression.

After Nielsen et al. 2015, "On Optimal, Minimal BRDF Sampling for Reflectance Acquisition".
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

REFLECTANCE_EPSILON = 1e-3  # as published: what keeps logs finite, and cosines off 0
GRAM_BLOCK_ROWS = 8192  # that a Gram matrix is summed over at once
MIN_ERROR_SHARE = 0.3  # of the mean error: smaller ones weigh no more


class Components(NamedTuple):
    """Principal components of log((f w + e) / (f0 w + e)), the log-relative reflectance, at places.

    Attributes:
        cos: of theta_i, [N, 1].
        weight: w, the product of both cosines, EPSILON at least, [N, 1].
        reference: f0, the median of training BRDFs, [N, 1] in 1/sr.
        mean: of the log-relative reflectance, [N, 1].
        axes: [N, K], orthogonal, each scaled to a root mean square of 1, the most important first.
        deviation: of training BRDFs along each, [K].
    """

    cos: Tensor
    weight: Tensor
    reference: Tensor
    mean: Tensor
    axes: Tensor
    deviation: Tensor

    def first(self, count: int) -> Components:
        """The most important ones, contiguous."""
        return self._replace(axes=self.axes[:, :count].contiguous(), deviation=self.deviation[:count])

    def at(self, rows: Tensor | slice) -> Components:
        """At some of the places."""
        cos, weight, reference, mean, axes = (each[rows] for each in self[:5])
        return Components(cos, weight, reference, mean, axes, self.deviation)

    def mapped(self, reflectance: Tensor) -> Tensor:
        """Log-relative reflectance of reflectance [N, C] in 1/sr."""
        return torch.log(
            (reflectance * self.weight + REFLECTANCE_EPSILON) / (self.reference * self.weight + REFLECTANCE_EPSILON)
        )

    def reflectance(self, coefficients: Tensor) -> Tensor:
        """Of coefficients [K, C], [N, C] in 1/sr, at least 0."""
        full = torch.exp(self.axes @ coefficients + self.mean) * (self.reference * self.weight + REFLECTANCE_EPSILON)
        return ((full - REFLECTANCE_EPSILON) / self.weight).clamp_min(0)

    def coefficients(self, target: Tensor, penalty: float, solves: int) -> Tensor:
        """The coefficients [K, C] of log(1 + f cos theta_i), [N, C], whose absolute errors count.

        Iteratively reweighted least squares: weights, of mean 1, are slope^2 / |error|, the slope that of the error
        over the residual; at first just the slope, as if residuals were all alike. Coefficients are drawn towards 0 by
        how little training BRDFs vary along them.
        """
        reflectance = target.expm1() / self.cos
        found = residual = self.mapped(reflectance) - self.mean
        weights = slope = self.cos * (reflectance + REFLECTANCE_EPSILON / self.weight) / target.exp()
        drawn = penalty * len(target) / self.deviation.double().square()
        for solve in range(solves):
            if solve:
                error = (torch.log1p(self.reflectance(found) * self.cos) - target).abs()
                weights = slope * slope / (error + MIN_ERROR_SHARE * error.mean(0)).clamp_min(1e-12)
            channels = zip(residual.T, (weights / weights.mean(0)).T, strict=True)
            found = torch.stack([solve_weighted_ridge(self.axes, *channel, drawn) for channel in channels], 1)
        return found


def principal_components(columns: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Mean, axes and deviation, as of `Components`, of columns [N, C], up to `count`.

    By their Gram matrix, in double precision. Those that vary by less than rounding are left out.
    """
    mean = columns.mean(1, keepdim=True)
    gram = torch.zeros(columns.shape[1], columns.shape[1], dtype=torch.float64)
    for part, middle in zip(columns.split(GRAM_BLOCK_ROWS), mean.split(GRAM_BLOCK_ROWS), strict=True):
        centred = (part - middle).double()
        gram += centred.T @ centred
    squared, vectors = torch.linalg.eigh(gram)
    order = torch.arange(len(squared) - 1, -1, -1)[:count]
    order = order[squared[order] > 1e-12 * squared[-1]]
    scale = math.sqrt(len(columns)) / squared[order].sqrt()
    axes = (columns - mean) @ (vectors[:, order] * scale).to(columns)
    return mean, axes, (1 / scale * math.sqrt(1 / columns.shape[1])).to(columns)


def solve_weighted_ridge(axes: Tensor, target: Tensor, weight: Tensor, penalty: Tensor) -> Tensor:
    """Coefficients [K] of axes [n, K] that fit a target [n], of squared residuals by weight [n], penalties [K].

    By normal equations; by QR in double precision where rounding would hide that these are positive definite: of fewer
    samples than axes and a small penalty.
    """
    weighted = axes * weight[:, None]
    left = (axes.T @ weighted).double() + torch.diag(penalty)
    factor, failed = torch.linalg.cholesky_ex(left)
    # rounding changes pivots by about this much: smaller ones are made of it, even where the factorisation succeeds
    rounding = torch.finfo(axes.dtype).eps * left.diagonal().sum()
    if failed or factor.diagonal().square().amin() < rounding:
        root = weight.double().sqrt()[:, None]
        q, r = torch.linalg.qr(torch.cat([root * axes, torch.diag(penalty.sqrt())]))
        solved: Tensor = torch.linalg.solve_triangular(r, q[: len(axes)].T @ (root * target[:, None]), upper=True)
    else:
        solved = torch.cholesky_solve((weighted.T @ target).double()[:, None], factor)
    return solved[:, 0].to(target)
