"""The contour of a glossy ball, found to a fraction of a pixel by the brightness across its rim.

Towards its rim a glossy ball mirrors more and more of what it lies on (Fresnel), so that a dark ball fades into a
bright table, and the steepest edge is some per cent inside the contour. So brightness across the rim is fitted by a
step at the contour and a rise of Fresnel's form before it, in any proportion.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares

from data_tools.readers.colours import Floats
from metapp.extensions.capture.ball.ball_geometry import Ball

_RIM_RADII = (0.7, 1.25)  # between which brightness is fitted
_SECTORS = 16  # of the rim, each with a brightness of its own on both sides
_GRID_MARGIN = 0.3  # of the radius, on both sides of the rim
_GRID_PX = 0.1  # step of the profiles, which are blurred and then looked up
_FIRST_BLUR_PX, _BLURS_PX = 0.7, (0.3, 3.0)  # standard deviation of the blur of camera and pixels
_RIDGE = 1e-3  # relative penalty on the contrast of profiles
_MAX_CHANGE = 0.1  # of the radius, by which place and radius change


def fit_rim(picture: Floats, ball: Ball) -> Ball:
    """Return a ball moved to where the brightness across its rim is explained best.

    Args:
        picture: the ball and its surroundings in linear light, [h, w], without highlights and shadows.
        ball: the ball, known to some per cent of its radius, in px of the picture.
    """
    rows, columns = (np.arange(side) + 0.5 for side in picture.shape)
    px = np.stack(np.meshgrid(columns, rows))
    distance = np.hypot(*ball.to_places(px))
    is_rim = (distance > _RIM_RADII[0]) & (distance < _RIM_RADII[1])  # the same pixels for all circles
    px, values = px[:, is_rim], picture[is_rim] / max(float(picture[is_rim].mean()), 1e-6)

    right, up = ball.to_places(px)
    sectors = (np.arctan2(up, right) / (2 * np.pi) % 1 * _SECTORS).astype(int) % _SECTORS

    def change_ball(change: Floats) -> Ball:
        x, y, radius = (ball.radius * change[:3] + ball[:3]).tolist()
        return ball._replace(x=x, y=y, radius=radius)

    def find_residuals(change: Floats) -> Floats:
        moved = change_ball(change)
        profiles = _look_up_profiles(np.hypot(*moved.to_places(px)), moved.radius, float(change[3]), float(change[4]))
        residuals: Floats = values - _explain(values, profiles, sectors)
        return residuals

    bounds = ([-_MAX_CHANGE] * 3 + [_BLURS_PX[0], 0.0], [_MAX_CHANGE] * 3 + [_BLURS_PX[1], 1.0])
    first = np.array([0.0, 0.0, 0.0, _FIRST_BLUR_PX, 0.5])
    return change_ball(least_squares(find_residuals, first, bounds=bounds, diff_step=1e-3, max_nfev=30).x)


def _explain(values: Floats, profiles: Floats, sectors: NDArray[np.int_]) -> Floats:
    """Return the brightness [P] that profiles [3, P] explain best of values [P], in each sector for itself."""
    products = np.concatenate([(profiles[:, None] * profiles).reshape(9, -1), profiles * values])
    sums = np.stack([np.bincount(sectors, product, _SECTORS) for product in products], 1)
    ridge = np.diag([1e-9, *[_RIDGE * len(values) / _SECTORS] * 2])
    contrasts = np.linalg.solve(sums[:, :9].reshape(-1, 3, 3) + ridge, sums[:, 9:, None])[..., 0]
    explained: Floats = (profiles * contrasts.T[:, sectors]).sum(0)
    return explained


def _look_up_profiles(distance: Floats, radius_px: float, blur_px: float, fresnel_share: float) -> Floats:
    """Return profiles across a blurred rim at distances from its middle in radii, [P]: [3, P].

    They are 1, the contrast at the rim, and a line inside it, as a body is shaded. `fresnel_share` of the contrast is
    Fresnel's rise (Schlick 1994), the rest is a step.
    """
    grid = np.arange(_RIM_RADII[0] - _GRID_MARGIN, _RIM_RADII[1] + _GRID_MARGIN, _GRID_PX / radius_px)
    outside = grid > 1
    fresnel = np.where(outside, 1.0, (1 - np.sqrt((1 - grid**2).clip(0))) ** 5)
    curves = np.stack([outside + fresnel_share * (fresnel - outside), (grid - 1).clip(max=0)])
    blurred = gaussian_filter1d(curves, blur_px / _GRID_PX, axis=1, mode="nearest")
    return np.stack([np.ones_like(distance), *(np.interp(distance, grid, curve) for curve in blurred)])
