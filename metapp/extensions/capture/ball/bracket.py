"""Photographs of one ball at several exposures: aligned by OpenCV, and merged by a power of sRGB's curve.

After Debevec & Malik 1997, "Recovering High Dynamic Range Radiance Maps from Photographs". Pictures [N, 4, S, S] are of
the ball alone, as :func:`extract_ball` returns them.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from data_tools.readers.colours import Floats
from data_tools.readers.image_files import Pixels
from data_tools.readers.opened_images import is_heif, open_largest_picture
from metapp.appearance.colour import linear_to_srgb
from metapp.apps.illumination.mirror import CLIPPED_DISPLAY_VALUE
from metapp.extensions.capture.ball.ball_geometry import Ball, disc_places
from metapp.extensions.capture.ball.ball_picture import extract_ball
from metapp.extensions.capture.hand_photos import import_opencv
from metapp.options import BadOption

_MIN_EXPOSURE_SECONDS = 1e-6  # the longest exposure is 1 divided by it
_ALIGNMENT_PX = 256  # side of the pictures that are aligned
_LOG_OFFSET, _MAX_ALIGNED_VALUE = 0.003, 0.85  # linear values: added before the logarithm; brighter ones do not align
_ECC_CRITERIA = (3, 100, 1e-5)  # OpenCV's: stop after 100 steps, or when the correlation grows by less than 1e-5
_MIN_COMPARED_VALUE, _MAX_COMPARED_VALUE = 0.007, 0.78  # linear values between which exposures are compared
_MIN_COMPARED_PX = 50  # two exposures that share fewer pixels are not compared


def read_exposures(paths: Sequence[Path], shutter: str) -> Floats:
    """Return the exposures [N] of photographs, in any unit.

    Args:
        paths: the photographs.
        shutter: exposure times such as "1/20,1/60", in the order of the photographs; "auto" reads them from EXIF. For
            one photograph the exposure does not matter.

    Raises:
        BadOption: a time is not a number, or out of range.
        ValueError: there are more or fewer times than photographs, or EXIF states no different exposures.
    """
    if shutter != "auto":
        exposures = np.array([_parse_seconds(part.strip(), shutter) for part in shutter.split(",")])
        if len(exposures) != len(paths):
            counts = f"exposures: {len(exposures)} for {len(paths)} photo{'s' * (len(paths) != 1)}"
            raise ValueError(f"{counts}, expected one for each, in their order.")
    elif len(paths) == 1:
        exposures = np.ones(1)
    else:
        exposures = np.array([exif_exposure(path) for path in paths])
        if not exposures.all() or np.ptp(exposures) == 0:
            fault = "the exposure of all photos" if exposures.all() else "no exposure time"
            raise ValueError(
                f"{paths[int(exposures.argmin())]}: {fault} in its EXIF, expected different ones; give them: "
                "--shutter 1/20,1/60,1/160."
            )
    return exposures


def pair_by_brightness(exposures: Floats, brightness: Sequence[float], paths: Sequence[Path]) -> Floats:
    """Return exposures in the order of photographs, the longest for the brightest, and warn if that is another order.

    A shell sorts a-10, a-160, a-40, unlike the times that its user states. An order that is reversed as a whole stays:
    60 may stand for 1/60.

    Args:
        exposures: exposure times as the user states them, [N].
        brightness: the mean display value of each photograph.
        paths: the photographs.
    """
    darkest_first = np.argsort(brightness, kind="stable")
    steps = np.diff(exposures[darkest_first])
    if (steps >= 0).all() or (steps <= 0).all():
        return exposures
    paired = np.empty_like(exposures)
    paired[darkest_first] = np.sort(exposures)
    pairs = ", ".join(f"{path.name} {seconds:.4g} s" for path, seconds in zip(paths, paired.tolist(), strict=True))
    warnings.warn(
        f"--shutter: times in another order than the photos' brightness, taken by brightness: {pairs}.", stacklevel=2
    )
    return paired


def _parse_seconds(text: str, shutter: str) -> float:
    """Return the seconds that a text such as "1/20" states; `shutter` is the whole option, for the message."""
    numerator, _, denominator = text.partition("/")
    try:
        seconds = float(numerator) / float(denominator or 1)
    except (ValueError, ZeroDivisionError):
        seconds = math.nan
    if not _MIN_EXPOSURE_SECONDS <= seconds <= 1 / _MIN_EXPOSURE_SECONDS:
        raise BadOption(f"--shutter '{text}' of '{shutter}': expected exposure times such as 1/20,1/60,1/160.")
    return seconds


def exif_exposure(path: Path) -> float:
    """Return the exposure that EXIF states: seconds times ISO / 100, over the square of the f-number.

    It is 0 if EXIF does not state the time; ISO and f-number count as 100 and 1 if EXIF does not state them.
    """
    if is_heif(path):
        return 0.0
    with open_largest_picture(path) as source:
        spec = source.spec()
        seconds, aperture = (spec.get_float_attribute(name, 0.0) for name in ("ExposureTime", "FNumber"))
        iso = spec.get_int_attribute("Exif:PhotographicSensitivity", 0) or 100
    exposure = seconds * iso / 100 / (aperture or 1) ** 2
    return exposure if 0 < exposure < math.inf else 0.0


def align_balls(photos: Sequence[Pixels], balls: Sequence[Ball], order: Sequence[int], first: int) -> list[Ball]:
    """Return the balls at the places and sizes by which photographs show alike in the same directions.

    Neighbouring exposures are aligned by phase correlation, then by the enhanced correlation coefficient (Evangelidis &
    Psarakis 2008), which exposure does not change.

    Args:
        photos: the photographs.
        balls: the balls in them; the first one's is right, the others' nearly so.
        order: the indices of photographs, by exposure, so that neighbours are compared.
        first: the index of the photograph whose ball stays.

    Raises:
        ValueError: OpenCV is not installed.
    """
    aligned, first_rank = list(balls), list(order).index(first)
    radius = np.hypot(*disc_places(_ALIGNMENT_PX))
    window, centre = np.clip((1 - radius) / 0.15, 0, 1), (_ALIGNMENT_PX - 1) / 2

    def read_logs(number: int) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the logarithms of a ball's mean channel, and where it is dark enough to be aligned."""
        light = extract_ball(photos[number], aligned[number], _ALIGNMENT_PX, balls[first].half_angle_rad)[:3]
        return np.log(light.mean(0) + _LOG_OFFSET), light.max(0) < _MAX_ALIGNED_VALUE

    for chain in (order[first_rank:], order[first_rank::-1]):
        for fixed, moving in itertools.pairwise(chain):
            cv2 = import_opencv()
            (fixed_logs, is_fixed_usable), (moving_logs, _) = read_logs(fixed), read_logs(moving)
            shift, _ = cv2.phaseCorrelate(*(window * (logs - logs.mean()) for logs in (fixed_logs, moving_logs)))
            aligned[moving] = _move_ball(aligned[moving], np.array(shift), 1.0)
            moving_logs, is_moving_usable = read_logs(moving)
            mask = ((radius < 0.96) & is_fixed_usable & is_moving_usable).astype(np.uint8)
            pictures, warp = (
                (fixed_logs.astype(np.float32), moving_logs.astype(np.float32)),
                np.eye(2, 3, dtype=np.float32),
            )
            try:
                _, warp = cv2.findTransformECC(*pictures, warp, cv2.MOTION_AFFINE, _ECC_CRITERIA, mask, 5)
            except cv2.error:  # the two exposures have too little in common
                continue
            scale = math.sqrt(abs(np.linalg.det(warp[:, :2])))
            aligned[moving] = _move_ball(aligned[moving], warp @ [centre, centre, 1] - centre, scale)
    return aligned


def _move_ball(ball: Ball, shift: Floats, size: float) -> Ball:
    """Return a ball moved by a shift in px of aligned pictures, and enlarged by a factor."""
    x, y = (shift * ball.radius * 2 / _ALIGNMENT_PX + ball[:2]).tolist()
    return ball._replace(x=x, y=y, radius=size * ball.radius)


def fit_curve_power(pictures: Floats, exposures: Floats) -> float:
    """Return the power of linear values by which photographs agree, by least squares; it is 1 for sRGB's curve.

    Args:
        pictures: the ball in each photograph, linear by sRGB's curve, [N, 4, S, S].
        exposures: the exposures, [N].
    """
    log_ratios = []
    for a, b in itertools.pairwise(np.argsort(exposures)):
        dark, bright = pictures[[a, b], :3]
        is_compared = (
            (pictures[[a, b], 3] > 0.99).all(0)
            & (dark.min(0) > _MIN_COMPARED_VALUE)
            & (bright.max(0) < _MAX_COMPARED_VALUE)
        )
        if is_compared.sum() >= _MIN_COMPARED_PX:
            log_ratio = np.median(np.log(bright[:, is_compared] / dark[:, is_compared]))
            log_ratios.append((log_ratio, np.log(exposures[b] / exposures[a])))
    measured_ratios, true_ratios = np.array(log_ratios or [(1.0, 1.0)]).T
    return float(measured_ratios @ true_ratios / (measured_ratios @ measured_ratios))


def merge_exposures(
    pictures: Floats, exposures: Floats, power: float, is_hdr: bool = False
) -> tuple[Floats, NDArray[np.bool_], list[float]]:
    """Merge photographs of several exposures into radiance.

    Args:
        pictures: the ball in each photograph, linear by sRGB's curve, [N, 4, S, S].
        exposures: the exposures, [N].
        power: the power of the camera's curve that :func:`fit_curve_power` returns.
        is_hdr: whether no value clips.

    Returns:
        Linear RGB [3, S, S], 1 for white in a photograph of exposure 1; a mask [S, S] of where all photographs are
        white; for each photograph the share by which its radiance typically differs from the merged one.
    """
    display = linear_to_srgb(torch.from_numpy(pictures[:, :3])).numpy()
    radiances = pictures[:, :3] ** power / exposures[:, None, None, None]
    below_white = ((0.97 - display) / 0.15).clip(float(is_hdr), 1)
    # where one channel of a pixel clips, the colour is wrong in the others, too
    weights = ((display - 0.01) / 0.15).clip(0, 1) * below_white * below_white.min(1, keepdims=True) * pictures[:, 3:]
    shortest, longest = exposures.argmin(), exposures.argmax()
    shortest_display = display[shortest].max(0) * pictures[shortest, 3]
    is_clipped = (shortest_display >= CLIPPED_DISPLAY_VALUE) & (not is_hdr)
    weighted_mean = (weights * radiances).sum(0) / weights.sum(0).clip(1e-6)
    fallback = np.where(shortest_display > 0.5, radiances[shortest], radiances[longest])
    radiance = np.where((weights.sum(0) > 1e-3) & ~is_clipped, weighted_mean, fallback)
    differences = np.abs(np.log(radiances.clip(1e-9) / radiance.clip(1e-9)))
    used_differences = [deviation[weight > 0.3] for deviation, weight in zip(differences, weights, strict=True)]
    return (
        radiance,
        is_clipped,
        [float(np.median(deviation)) if deviation.size else 0.0 for deviation in used_differences],
    )
