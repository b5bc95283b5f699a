"""Photographs of one ball at several exposures: aligned by OpenCV, and merged by a power of sRGB's curve.

After Debevec & Malik 1997, "Recovering High Dynamic Range Radiance Maps from Photographs". Pictures are of the ball
alone, as of `extract_ball`, [N, 4, S, S].
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from data_tools.readers.colours import Floats
from data_tools.readers.image_files import Pixels, is_heif, open_largest_picture
from metapp.appearance.colour import linear_to_srgb
from metapp.apps.illumination.mirror import CLIPPED_VALUE
from metapp.extensions.capture.ball.ball_geometry import Ball, disc_places
from metapp.extensions.capture.ball.ball_picture import extract_ball
from metapp.extensions.capture.hand_photos import import_opencv
from metapp.options import BadOption

_SHORTEST_SECONDS = 1e-6  # 1 over it is the longest exposure
_ALIGNED_PX = 256  # side of pictures that are aligned
_DARK, _BRIGHT = 0.003, 0.85  # linear values: added before their logarithm; from which on none is aligned
_ENDS = (3, 100, 1e-5)  # OpenCV's criteria: at most so many steps, or until the correlation grows by less
_LOW, _HIGH = 0.007, 0.78  # linear values by which exposures are compared
_FEWEST_PX = 50  # by which two exposures are


def read_exposures(paths: Sequence[Path], shutter: str) -> Floats:
    """The exposures of photographs [N], in any unit.

    Args:
        paths: the photographs.
        shutter: such as "1/20,1/60", in their order; "auto": as EXIF says; of one photograph it does not matter.

    Raises:
        BadOption: a time that cannot be.
        ValueError: another number of times than of photographs; no different ones in EXIF.
    """
    if shutter != "auto":
        values = np.array([_seconds(part.strip(), shutter) for part in shutter.split(",")])
        if len(values) != len(paths):
            counts = f"exposures: {len(values)} for {len(paths)} photo{'s' * (len(paths) != 1)}"
            raise ValueError(f"{counts}, expected one for each, in their order.")
    elif len(paths) == 1:
        values = np.ones(1)
    else:
        values = np.array([exif_exposure(path) for path in paths])
        if not values.all() or np.ptp(values) == 0:
            found = "the exposure of all photos" if values.all() else "no exposure time"
            raise ValueError(
                f"{paths[int(values.argmin())]}: {found} in its EXIF, expected different ones; give them: "
                "--shutter 1/20,1/60,1/160."
            )
    return values


def _seconds(text: str, shutter: str) -> float:
    above, _, below = text.partition("/")
    try:
        value = float(above) / float(below or 1)
    except (ValueError, ZeroDivisionError):
        value = math.nan
    if not _SHORTEST_SECONDS <= value <= 1 / _SHORTEST_SECONDS:
        raise BadOption(f"--shutter '{text}' of '{shutter}': expected exposure times such as 1/20,1/60,1/160.")
    return value


def exif_exposure(path: Path) -> float:
    """Seconds by ISO / 100 over the square of the f-number, as EXIF says; 0 if it does not say the time.

    ISO and f-number count as 100 and 1 if EXIF does not say them.
    """
    if is_heif(path):
        return 0.0
    with open_largest_picture(path) as source:
        spec = source.spec()
        seconds, aperture = (spec.get_float_attribute(name, 0.0) for name in ("ExposureTime", "FNumber"))
        iso = spec.get_int_attribute("Exif:PhotographicSensitivity", 0) or 100
    value = seconds * iso / 100 / (aperture or 1) ** 2
    return value if 0 < value < math.inf else 0.0


def align_balls(photos: Sequence[Pixels], balls: Sequence[Ball], order: Sequence[int], first: int) -> list[Ball]:
    """The balls of place and size that make photographs show the same in the same directions.

    By phase correlation, then by the enhanced correlation coefficient (Evangelidis & Psarakis 2008), to which exposures
    make no difference.

    Args:
        photos: the photographs.
        balls: in them; the first one's is right, others' nearly so.
        order: of the exposures, so that neighbours are compared.
        first: which one's ball stays.

    Raises:
        ValueError: OpenCV is not installed.
    """
    result, start = list(balls), list(order).index(first)
    away = np.hypot(*disc_places(_ALIGNED_PX))
    window, middle = np.clip((1 - away) / 0.15, 0, 1), (_ALIGNED_PX - 1) / 2

    def logs(number: int) -> tuple[Floats, NDArray[np.bool_]]:
        light = extract_ball(photos[number], result[number], _ALIGNED_PX, balls[first].angle)[:3]
        return np.log(light.mean(0) + _DARK), light.max(0) < _BRIGHT

    for way in (order[start:], order[start::-1]):
        for known, other in itertools.pairwise(way):
            cv2 = import_opencv()
            (target, is_known), (values, _) = logs(known), logs(other)
            shift, _ = cv2.phaseCorrelate(*(window * (each - each.mean()) for each in (target, values)))
            result[other] = _moved(result[other], np.array(shift), 1.0)
            values, is_seen = logs(other)
            mask = ((away < 0.96) & is_known & is_seen).astype(np.uint8)
            pictures, warp = (target.astype(np.float32), values.astype(np.float32)), np.eye(2, 3, dtype=np.float32)
            try:
                _, warp = cv2.findTransformECC(*pictures, warp, cv2.MOTION_AFFINE, _ENDS, mask, 5)
            except cv2.error:  # too little in common
                continue
            size = math.sqrt(abs(np.linalg.det(warp[:, :2])))
            result[other] = _moved(result[other], warp @ [middle, middle, 1] - middle, size)
    return result


def _moved(ball: Ball, shift: Floats, size: float) -> Ball:
    """A ball moved by px of pictures that are aligned, and enlarged."""
    x, y = (shift * ball.radius * 2 / _ALIGNED_PX + ball[:2]).tolist()
    return ball._replace(x=x, y=y, radius=size * ball.radius)


def fit_curve_power(pictures: Floats, exposures: Floats) -> float:
    """The power of linear values by which photographs agree, by least squares: 1 if their curve is sRGB's."""
    steps = []
    for a, b in itertools.pairwise(np.argsort(exposures)):
        dark, bright = pictures[[a, b], :3]
        is_seen = (pictures[[a, b], 3] > 0.99).all(0) & (dark.min(0) > _LOW) & (bright.max(0) < _HIGH)
        if is_seen.sum() >= _FEWEST_PX:
            measured = np.median(np.log(bright[:, is_seen] / dark[:, is_seen]))
            steps.append((measured, np.log(exposures[b] / exposures[a])))
    ratios, true = np.array(steps or [(1.0, 1.0)]).T
    return float(ratios @ true / (ratios @ ratios))


def merge_exposures(
    pictures: Floats, exposures: Floats, power: float, is_hdr: bool = False
) -> tuple[Floats, NDArray[np.bool_], list[float]]:
    """Radiance of photographs that show the same.

    Args:
        pictures: linear by sRGB's curve.
        exposures: [N].
        power: of the camera's curve, as of `fit_curve_power`.
        is_hdr: whether no value clips.

    Returns:
        Linear RGB [3, S, S], of which 1 is white in a photograph of exposure 1; where all photographs are white,
        [S, S]; the share by which each one's radiance typically differs from the merged one.
    """
    shown = linear_to_srgb(torch.from_numpy(pictures[:, :3])).numpy()
    radiances = pictures[:, :3] ** power / exposures[:, None, None, None]
    below_white = ((0.97 - shown) / 0.15).clip(float(is_hdr), 1)
    # colours of a pixel that clips in one channel are wrong in the others
    weights = ((shown - 0.01) / 0.15).clip(0, 1) * below_white * below_white.min(1, keepdims=True) * pictures[:, 3:]
    shortest, longest = exposures.argmin(), exposures.argmax()
    bright = shown[shortest].max(0) * pictures[shortest, 3]
    is_clipped = (bright >= CLIPPED_VALUE) & (not is_hdr)
    mean = (weights * radiances).sum(0) / weights.sum(0).clip(1e-6)
    instead = np.where(bright > 0.5, radiances[shortest], radiances[longest])
    radiance = np.where((weights.sum(0) > 1e-3) & ~is_clipped, mean, instead)
    differences = np.abs(np.log(radiances.clip(1e-9) / radiance.clip(1e-9)))
    used = [off[weight > 0.3] for off, weight in zip(differences, weights, strict=True)]
    return radiance, is_clipped, [float(np.median(off)) if off.size else 0.0 for off in used]
