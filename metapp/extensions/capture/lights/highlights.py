"""Highlights of a lamp on a glossy ball: where each photograph has one, and which direction it comes from.

A ball mirrors equal solid angles into equal areas if its camera is far away, so that the mean over the pixels of a
highlight, of the directions that they mirror, is the middle of the lamp, whatever the highlight's size.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, label

from data_tools.readers.colours import Floats
from metapp.extensions.capture.ball.ball_geometry import Ball, disc_to_directions

_JUDGED_RADIUS = 0.8  # of the disc: beyond, a ball mirrors what lies below it, such as the table it lies on
_DARK_SHARE = 0.25  # the rank of the photograph, at each pixel, that shows the ball without the lamp
_SPOT_SHARE = 0.4  # of the brightest value, above which pixels belong to a highlight
_BLUR_RADIUS, _MIN_BLUR_PX = 0.02, 0.7  # by which spots are smoothed: of the radius, and at least
_MIN_PEAK_DEVIATIONS, _MIN_PEAK = 6.0, 0.01  # of the noise, and in linear light: a lower peak is no highlight
_MIN_FLUX_SHARE = 0.1  # of the median flux of a ball's highlights: a weaker one is a reflection of something else
_MAX_RIVAL_SHARE = 0.5  # of the flux of the strongest spot: beside a stronger rival it is not known which is the lamp
_ONE_LAMP_COSINE = float(np.cos(np.radians(10)))  # spots in directions closer than this are of one lamp
_FIT_ROUNDS, _OUTLIER_DEVIATIONS = 4, 2.5  # of the fit of the ball's shading


class Highlight(NamedTuple):
    """What one photograph shows of the lamp on a ball.

    Attributes:
        direction: the direction to the lamp, [3], of unit length: x right, y up, z to the camera; NaN if not known.
        flux: the light of the highlight, in linear light times pixels of area.
        peak_px: where the highlight is brightest, px (right, down) of the pictures.
        fault: why the direction is not known; "" if it is.
    """

    direction: Floats
    flux: float
    peak_px: Floats
    fault: str = ""


def measure_highlights(pictures: Floats, ball: Ball) -> list[Highlight]:
    """Measure the highlight of the lamp in each picture of a ball.

    What stands out is what a picture shows beyond the dark quarter of all pictures, which has the constant reflections
    of the room, and beyond a smooth shading of the ball.

    Args:
        pictures: the ball and its surroundings in linear light, [N, h, w], by a camera that stands still.
        ball: the ball, in px of the pictures.
    """
    rows, columns = (np.arange(side) + 0.5 for side in pictures.shape[1:])
    places = ball.to_places(np.stack(np.meshgrid(columns, rows)))
    is_judged = np.hypot(*places) < _JUDGED_RADIUS
    directions = ball.to_camera(disc_to_directions(places[:, is_judged], ball.half_angle_rad))
    dark = np.sort(pictures[:, is_judged], 0)[int(_DARK_SHARE * (len(pictures) - 1))]
    blur_px = max(_MIN_BLUR_PX, _BLUR_RADIUS * ball.radius)
    highlights = []
    for picture in pictures:
        excess = np.zeros(picture.shape)
        excess[is_judged] = _remove_shading(picture[is_judged] - dark, places[:, is_judged])
        highlights.append(_measure_spot(gaussian_filter(excess, blur_px), is_judged, directions))
    fluxes = [highlight.flux for highlight in highlights if not highlight.fault]
    least_flux = _MIN_FLUX_SHARE * float(np.median(fluxes)) if fluxes else 0.0
    return [
        highlight._replace(fault=f"no highlight on the ball ({highlight.flux / least_flux * _MIN_FLUX_SHARE:.0%})")
        if not highlight.fault and highlight.flux < least_flux
        else highlight
        for highlight in highlights
    ]


def _remove_shading(values: Floats, places: Floats) -> Floats:
    """Subtract from values on a ball, [P] at places [2, P] in its disc, a smooth shading that spots do not change.

    The shading is a spherical harmonic of the second order, as a matt ball's nearly is (Ramamoorthi and Hanrahan 2001).
    """
    x, y = places
    z = np.sqrt(1 - x**2 - y**2)
    harmonics = np.stack([np.ones_like(x), x, y, z, x * y, x * z, y * z, x**2, y**2], 1)
    residuals, is_shading = values, np.ones(len(values), bool)
    for _ in range(_FIT_ROUNDS):
        chosen = harmonics[is_shading]
        gram = chosen.T @ chosen + 1e-6 * len(values) * np.eye(harmonics.shape[1])
        residuals = values - harmonics @ np.linalg.solve(gram, chosen.T @ values[is_shading])
        is_shading = residuals < max(_OUTLIER_DEVIATIONS * _robust_deviation(residuals), 1e-4)
    return residuals


def _robust_deviation(values: Floats) -> float:
    """Return the standard deviation of values, most of which are normally distributed about 0."""
    return 1.4826 * float(np.median(np.abs(values)))


def _measure_spot(excess: Floats, is_judged: NDArray[np.bool_], directions: Floats) -> Highlight:
    """Return the highlight of the strongest spot, with a fault if there is none, or others are as strong.

    Args:
        excess: how much brighter than without the lamp the ball is, [h, w], smoothed.
        is_judged: the pixels that count, [h, w].
        directions: the directions that they mirror, [3, P].
    """
    peak = float(excess[is_judged].max())
    row, column = np.unravel_index(np.where(is_judged, excess, -np.inf).argmax(), excess.shape)
    peak_px = np.array([column + 0.5, row + 0.5])
    if peak < max(_MIN_PEAK, _MIN_PEAK_DEVIATIONS * _robust_deviation(excess[is_judged])):
        return Highlight(np.full(3, np.nan), 0.0, peak_px, "no highlight on the ball")
    spots, count = label((excess > _SPOT_SHARE * peak) & is_judged)
    numbers, weights = spots[is_judged], (excess[is_judged] - _SPOT_SHARE * peak).clip(0)
    sums = np.stack([np.bincount(numbers, weights * axis, count + 1)[1:] for axis in directions], 1)
    fluxes = np.bincount(numbers, excess[is_judged], count + 1)[1:]
    towards = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12)
    is_of_lamp = towards @ towards[fluxes.argmax()] > _ONE_LAMP_COSINE
    direction = sums[is_of_lamp].sum(0)
    direction, flux = direction / np.linalg.norm(direction), float(fluxes[is_of_lamp].sum())
    rival_share = float(fluxes[~is_of_lamp].max(initial=0)) / flux
    if rival_share > _MAX_RIVAL_SHARE:
        fault = (
            f"{1 + np.sum(fluxes[~is_of_lamp] > _MAX_RIVAL_SHARE * flux)} highlights of similar strength on the ball"
        )
        return Highlight(np.full(3, np.nan), flux, peak_px, f"{fault} ({rival_share:.0%} of the strongest)")
    return Highlight(direction, flux, peak_px)
