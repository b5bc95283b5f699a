"""Principal components of log-relative reflectance, and coefficients by weighted ridge regression.

After Nielsen et al. 2015, "On Optimal, Minimal BRDF Sampling for Reflectance Acquisition". Nothing here knows of tasks
or of baselines.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

REFLECTANCE_EPSILON = 1e-3  # as published: keeps logarithms finite, and products of cosines away from 0
GRAM_BLOCK_ROWS = 8192  # rows over which a Gram matrix is summed at once
MIN_ERROR_SHARE = 0.3  # of the mean error: a sample of a smaller error weighs no more


class Components(NamedTuple):
    """Principal components of the log-relative reflectance, log((f w + e) / (f0 w + e)), at N places.

    Attributes:
        cos: cos theta_i, [N, 1].
        weight: w, the product of the cosines of both directions, at least e = REFLECTANCE_EPSILON, [N, 1].
        reference: f0, the median of training BRDFs, [N, 1] in 1/sr.
        mean: the mean log-relative reflectance of training BRDFs, [N, 1].
        axes: the components, [N, K], orthogonal, each scaled to a root mean square of 1, the most important first.
        deviation: the standard deviation of training BRDFs along each component, [K].
    """

    cos: Tensor
    weight: Tensor
    reference: Tensor
    mean: Tensor
    axes: Tensor
    deviation: Tensor

    def select_components(self, count: int) -> Components:
        """Return the `count` most important components, contiguous in memory."""
        return self._replace(axes=self.axes[:, :count].contiguous(), deviation=self.deviation[:count])

    def select_places(self, rows: Tensor | slice) -> Components:
        """Return the components at some of the places."""
        cos, weight, reference, mean, axes = (values[rows] for values in self[:5])
        return Components(cos, weight, reference, mean, axes, self.deviation)

    def log_relative_reflectance(self, reflectance: Tensor) -> Tensor:
        """Return the log-relative reflectance [N, C] of reflectance [N, C] in 1/sr."""
        return torch.log(
            (reflectance * self.weight + REFLECTANCE_EPSILON) / (self.reference * self.weight + REFLECTANCE_EPSILON)
        )

    def reflectance(self, coefficients: Tensor) -> Tensor:
        """Return the reflectance [N, C] in 1/sr, at least 0, of coefficients [K, C]."""
        offset_reflectance = torch.exp(self.axes @ coefficients + self.mean) * (
            self.reference * self.weight + REFLECTANCE_EPSILON
        )
        return ((offset_reflectance - REFLECTANCE_EPSILON) / self.weight).clamp_min(0)

    def solve_coefficients(self, target: Tensor, penalty: float, solves: int) -> Tensor:
        """Solve the coefficients of channels by iteratively reweighted least squares of absolute errors.

        Weights, of mean 1, are slope^2 / |error|, where the slope is the derivative of the error by the residual; in
        the first solve they are the slope alone, as if all residuals were alike. Coefficients are drawn towards 0, the
        more the less training BRDFs vary along a component.

        Args:
            target: log(1 + f cos theta_i), [N, C].
            penalty: the strength of the ridge, for each sample.
            solves: the number of solves.

        Returns:
            The coefficients, [K, C].
        """
        reflectance = target.expm1() / self.cos
        coefficients = residual = self.log_relative_reflectance(reflectance) - self.mean
        weights = slope = self.cos * (reflectance + REFLECTANCE_EPSILON / self.weight) / target.exp()
        penalties = penalty * len(target) / self.deviation.double().square()
        for solve in range(solves):
            if solve:
                error = (torch.log1p(self.reflectance(coefficients) * self.cos) - target).abs()
                weights = slope * slope / (error + MIN_ERROR_SHARE * error.mean(0)).clamp_min(1e-12)
            channels = zip(residual.T, (weights / weights.mean(0)).T, strict=True)
            coefficients = torch.stack(
                [solve_weighted_ridge(self.axes, *channel, penalties) for channel in channels], 1
            )
        return coefficients


def principal_components(columns: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return the mean, the components and their deviations of columns, by the columns' Gram matrix in double precision.

    Components along which columns vary by less than rounding are left out.

    Args:
        columns: the vectors, [N, C].
        count: how many components to return, at most.

    Returns:
        The mean [N, 1], the axes [N, K] and the deviations [K] that :class:`Components` has.
    """
    mean = columns.mean(1, keepdim=True)
    gram = torch.zeros(columns.shape[1], columns.shape[1], dtype=torch.float64)
    for block, block_mean in zip(columns.split(GRAM_BLOCK_ROWS), mean.split(GRAM_BLOCK_ROWS), strict=True):
        centred = (block - block_mean).double()
        gram += centred.T @ centred
    eigenvalues, eigenvectors = torch.linalg.eigh(gram)
    order = torch.arange(len(eigenvalues) - 1, -1, -1)[:count]
    order = order[eigenvalues[order] > 1e-12 * eigenvalues[-1]]
    scale = math.sqrt(len(columns)) / eigenvalues[order].sqrt()
    axes = (columns - mean) @ (eigenvectors[:, order] * scale).to(columns)
    return mean, axes, (1 / scale * math.sqrt(1 / columns.shape[1])).to(columns)


def solve_weighted_ridge(axes: Tensor, target: Tensor, weight: Tensor, penalty: Tensor) -> Tensor:
    """Solve a ridge regression with weighted residuals.

    It is solved by normal equations, or by QR in double precision where rounding would hide that these are positive
    definite: with fewer samples than axes and a small penalty.

    Args:
        axes: the regressors, [n, K].
        target: the regressed values, [n].
        weight: the weight of each squared residual, [n].
        penalty: the weight of each squared coefficient, [K].

    Returns:
        The coefficients, [K].
    """
    weighted_axes = axes * weight[:, None]
    normal_matrix = (axes.T @ weighted_axes).double() + torch.diag(penalty)
    factor, failed = torch.linalg.cholesky_ex(normal_matrix)
    # Rounding changes pivots by about this much; smaller pivots are noise, even where the factorisation succeeds.
    rounding = torch.finfo(axes.dtype).eps * normal_matrix.diagonal().sum()
    if failed or factor.diagonal().square().amin() < rounding:
        root_weight = weight.double().sqrt()[:, None]
        q, r = torch.linalg.qr(torch.cat([root_weight * axes, torch.diag(penalty.sqrt())]))
        solution: Tensor = torch.linalg.solve_triangular(
            r, q[: len(axes)].T @ (root_weight * target[:, None]), upper=True
        )
    else:
        solution = torch.cholesky_solve((weighted_axes.T @ target).double()[:, None], factor)
    return solution[:, 0].to(target)
