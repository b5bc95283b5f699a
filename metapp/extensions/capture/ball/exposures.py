"""Exposures of photographs, and radiance merged from several, by sRGB's curve or by one that is recovered.

After Debevec & Malik 1997, "Recovering High Dynamic Range Radiance Maps from Photographs".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from data_tools.readers.image_files import is_heif, opened
from metapp.appearance.colour import srgb_to_linear
from metapp.apps.illumination.mirror import CLIPPED
from metapp.extensions.capture.ball.view import Floats

SHORTEST = 1e-6  # s; 1 over it is the longest

_DARK = 0.03  # display value that says little
_KNOTS = 32  # of a camera's curve
_SAMPLES = 600  # pixels that tell it
_SHOWN = 6  # values of a pixel, of three a photograph, that are neither dark nor white
_SMOOTH = 3.0  # weight of its second difference

Curve = Callable[[Floats], Floats]  # linear values of display values [3, ...]


class Merged(NamedTuple):
    """Radiance of several photographs.

    Attributes:
        radiance: linear RGB [3, S, S]; 1 is white in a photograph of exposure 1.
        clipped: [S, S], where all photographs are white.
        residuals: of each photograph, by what share its radiance typically differs from the merged one; 0 for one.
    """

    radiance: Floats
    clipped: NDArray[np.bool_]
    residuals: list[float]


def parsed(text: str) -> tuple[float, ...]:
    """Exposures such as "1/20,1/60" or "0.05,0.017".

    Raises:
        ValueError: not numbers from SHORTEST to 1 / SHORTEST.
    """
    values = []
    for part in text.split(","):
        above, _, below = part.strip().partition("/")
        try:
            value = float(above) / (float(below) if below else 1)
        except (ValueError, ZeroDivisionError):
            value = math.nan
        if not SHORTEST <= value <= 1 / SHORTEST:
            raise ValueError(f"'{part.strip()}' of '{text}', expected exposure times such as 1/20,1/60,1/160")
        values.append(value)
    return tuple(values)


def exif_exposure(path: Path) -> float:
    """Time in s by ISO / 100 over the square of the f-number, as EXIF says; 0 where it does not say the time.

    What it does not say of ISO and f-number counts as 100 and 1.
    """
    if is_heif(path):
        return 0.0
    with opened(path) as source:
        spec = source.spec()

        def value(*names: str) -> float:
            found = [float(spec.get_float_attribute(name, 0.0)) for name in names]
            return next((number for number in found if 0 < number < math.inf), 0.0)

        seconds = value("ExposureTime")
        stops = spec.getattribute("Exif:ShutterSpeedValue")
        if not seconds and isinstance(stops, int | float):
            seconds = 2.0 ** -float(np.clip(stops, -20, 20))
        iso = value("Exif:PhotographicSensitivity", "Exif:ISOSpeedRatings")
        if not iso:
            iso = float(spec.get_int_attribute("Exif:PhotographicSensitivity", 0))
        return seconds * (iso or 100) / 100 / (value("FNumber") or 1) ** 2


def srgb_light(display: Floats) -> Floats:
    """Linear values of display values, by sRGB's curve."""
    result: Floats = srgb_to_linear(torch.from_numpy(display)).numpy()
    return result


def recovered_curve(displays: Sequence[Floats], seen: Sequence[NDArray[np.bool_]], exposures: Floats) -> Curve:
    """The curve that makes photographs agree, by linear least squares; gray stays gray where they are half bright.

    Args:
        displays: display values [3, S, S] of each.
        seen: where each shows the ball, [S, S].
        exposures: [N].
    """
    from scipy.ndimage import gaussian_filter

    stack = np.stack(displays)
    smooth = np.stack([gaussian_filter(picture, (0, 1, 1)) for picture in stack])
    edges = np.abs(np.gradient(smooth.max(0), axis=(1, 2))).sum((0, 1))
    usable = np.all(seen, 0) & (edges < np.quantile(edges[np.all(seen, 0)], 0.6))
    many = ((smooth > _DARK) & (smooth < 0.95)).sum((0, 1))
    places = np.flatnonzero(usable & (many >= _SHOWN))
    rng = np.random.default_rng(0)
    places = rng.choice(places, min(_SAMPLES, len(places)), replace=False)
    knots = [_solved(smooth[:, c].reshape(len(stack), -1)[:, places], np.log(exposures)) for c in range(3)]
    even = np.linspace(0, 1, _KNOTS)
    return lambda display: np.exp(
        np.stack([np.interp(plane, even, logs) for plane, logs in zip(display, knots, strict=True)])
    )


def _solved(values: Floats, logs: Floats) -> Floats:
    """Knots [K] of the curve of display values [N, P] of photographs whose exposures' logarithms are [N]."""
    count, pixels = values.shape
    place = np.clip(values, 0, 1) * (_KNOTS - 1)
    low = np.minimum(place.astype(int), _KNOTS - 2)
    part = place - low
    weight = _hat(values)
    rows = np.arange(count * pixels)
    system = np.zeros((count * pixels + _KNOTS - 1, _KNOTS + pixels))
    target = np.zeros(len(system))
    flat = weight.ravel()
    system[rows, low.ravel()] = flat * (1 - part.ravel())
    system[rows, low.ravel() + 1] = flat * part.ravel()
    system[rows, _KNOTS + np.tile(np.arange(pixels), count)] = -flat
    target[rows] = flat * np.repeat(logs, pixels)
    # the second difference of what sRGB's curve leaves, so that little data changes it little
    known = np.log(np.maximum(srgb_light(np.linspace(0, 1, _KNOTS)), 1e-3))
    smooth = np.diff(np.eye(_KNOTS), 2, axis=0) * _SMOOTH * math.sqrt(pixels / 100 + 1)
    system[len(rows) : -1, :_KNOTS] = smooth
    target[len(rows) : -1] = smooth @ known
    middle = (_KNOTS - 1) // 2
    system[-1, middle], target[-1] = 1e3, 1e3 * known[middle]
    solution: Floats = np.linalg.lstsq(system, target, rcond=None)[0]
    return np.maximum.accumulate(solution[:_KNOTS])


def _hat(display: Floats) -> Floats:
    """Weights of display values in [0, 1]: 0 at black and white."""
    result: Floats = np.clip((display - 0.01) / 0.15, 0, 1) * _hat_top(display)
    return result


def _hat_top(display: Floats) -> Floats:
    """1, but towards white 0."""
    result: Floats = np.clip((0.97 - display) / 0.15, 0, 1)
    return result


def merged(
    displays: Sequence[Floats], seen: Sequence[NDArray[np.bool_]], exposures: Floats, curve: Curve = srgb_light
) -> Merged:
    """Radiance of photographs that show the same.

    Args:
        displays: display values [3, S, S] of each.
        seen: where each shows the ball.
        exposures: [N].
        curve: of the camera.
    """
    radiances = [curve(display) / exposure for display, exposure in zip(displays, exposures, strict=True)]
    # colours of a pixel that clips in one channel are wrong in the others
    weights = [
        _hat(display) * (_hat_top(display.max(0)) * there) for display, there in zip(displays, seen, strict=True)
    ]
    total = sum(weights)
    shortest, longest = int(np.argmin(exposures)), int(np.argmax(exposures))
    bright = displays[shortest].max(0) * seen[shortest]
    clipped = bright >= CLIPPED
    radiance = sum(weight * value for weight, value in zip(weights, radiances, strict=True)) / np.maximum(total, 1e-6)
    instead = np.where(bright > 0.5, radiances[shortest], radiances[longest])
    radiance = np.where((total > 1e-3) & ~clipped, radiance, instead)
    residuals = [_residual(value, radiance, weight) for value, weight in zip(radiances, weights, strict=True)]
    return Merged(radiance, clipped, residuals)


def _residual(value: Floats, radiance: Floats, weight: Floats) -> float:
    used = weight > 0.3
    if not used.any():
        return 0.0
    return float(np.median(np.abs(np.log(np.maximum(value[used], 1e-9) / np.maximum(radiance[used], 1e-9)))))
