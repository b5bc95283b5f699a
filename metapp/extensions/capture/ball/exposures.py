"""Exposures of photographs, and radiance merged from several, by a power of sRGB's curve.

After Debevec & Malik 1997, "Recovering High Dynamic Range Radiance Maps from Photographs".
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from data_tools.readers.image_files import is_heif, opened
from metapp.appearance.colour import linear_to_srgb
from metapp.apps.illumination.mirror import CLIPPED_VALUE
from metapp.extensions.capture.ball.view import Floats

SHORTEST = 1e-6  # s; 1 over it is the longest

_LOW, _HIGH = 0.007, 0.78  # linear values that photographs are compared by
_FEWEST = 50  # px, that say how two compare


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


def power_of(lights: Sequence[Floats], seen: Sequence[NDArray[np.bool_]], exposures: Floats) -> float:
    """The power of the values of photographs by which they agree, by least squares: 1 where their curve is sRGB's.

    Args:
        lights: values [3, S, S] of each, linear by sRGB's curve.
        seen: where each shows the ball, [S, S].
        exposures: [N].
    """
    steps = []
    for a, b in itertools.pairwise(np.argsort(exposures)):
        usable = seen[a] & seen[b] & (lights[a].min(0) > _LOW) & (lights[b].max(0) < _HIGH)
        if usable.sum() >= _FEWEST:
            measured = np.median(np.log(lights[b][:, usable] / lights[a][:, usable]))
            steps.append((measured, np.log(exposures[b] / exposures[a])))
    measured, true = np.array(steps or [(1.0, 1.0)]).T
    return float(measured @ true / (measured @ measured))


def _hat(display: Floats) -> Floats:
    """Weights of display values in [0, 1]: 0 at black and white."""
    result: Floats = np.clip((display - 0.01) / 0.15, 0, 1) * _hat_top(display)
    return result


def _hat_top(display: Floats) -> Floats:
    """1, but towards white 0."""
    result: Floats = np.clip((0.97 - display) / 0.15, 0, 1)
    return result


def merged(
    lights: Sequence[Floats], seen: Sequence[NDArray[np.bool_]], exposures: Floats, power: float = 1.0
) -> Merged:
    """Radiance of photographs that show the same.

    Args:
        lights: values [3, S, S] of each, linear by sRGB's curve.
        seen: where each shows the ball.
        exposures: [N].
        power: of the camera's curve, as of `power_of`.
    """
    displays = [linear_to_srgb(torch.from_numpy(light)).numpy() for light in lights]
    radiances = [light**power / exposure for light, exposure in zip(lights, exposures, strict=True)]
    # colours of a pixel that clips in one channel are wrong in the others
    weights = [
        _hat(display) * (_hat_top(display.max(0)) * there) for display, there in zip(displays, seen, strict=True)
    ]
    total = sum(weights)
    shortest, longest = int(np.argmin(exposures)), int(np.argmax(exposures))
    bright = displays[shortest].max(0) * seen[shortest]
    clipped = bright >= CLIPPED_VALUE
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
