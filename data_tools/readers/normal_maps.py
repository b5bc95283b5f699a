"""Normal maps as programs store them: with z in blue, without z, or with x in alpha, as texture compression does.

A file of two channels (BC5, red and green), or one whose blue holds something else, such as 255 all over, still has z,
as normals have unit length: sqrt(1 - x^2 - y^2). Files of DXT5nm have x in alpha, and red is 255 all over.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from data_tools.readers.colours import Array, Floats, integers_to_unit_range

_SAMPLE_PX = 2**20  # px of a map, about, that are tested
_ROWS_AT_ONCE = 256  # rows rebuilt at a time: floats of a whole map take over 100 MB
_MAX_CONSTANT_DIFFERENCE = 1.5 / 255  # of a constant channel's values from their mean
_EXTREME_RANGE = 0.02  # distance from 0 or 1 of a constant channel that is no x or y: x = 1 all over is no surface
_MAX_LONG_SHARE = 0.01  # of px whose x and y are too long for a unit normal; 461 published maps have up to 0.001
_MAX_SQUARED_LENGTH = 1.05  # x^2 + y^2, which rounding may leave above 1
# Mean difference of blue from the z of unit normals, from which on blue is not z: absolute, and over the mean absolute
# deviation of z. The latter is at most 0.6 in 461 published maps, and at least 0.8 where blue holds another map or is
# constant, even in JPEG.
_MIN_Z_ERROR, _MIN_Z_ERROR_DEVIATIONS = 0.01, 0.7
_MIN_REPORTED_CHANGE = 0.05  # change of z from which on a warning tells of it


def complete_normals(values: Array, source: Path) -> Array:
    """Return normals of three channels, x, y and z, from a file's channels; a warning says what was rebuilt.

    Args:
        values: [H, W, 3], or 4 with alpha last, integers or floats of 0..1 for -1..1.
        source: the file, in messages.

    Raises:
        ValueError: red and green are the x and y of no normals: equal, constant at -1 or 1, or longer than 1.
    """
    step = max(1, round((values.shape[0] * values.shape[1] / _SAMPLE_PX) ** 0.5))
    sample = integers_to_unit_range(values[::step, ::step])
    if not np.isfinite(sample).all():
        return values[..., :3]  # the reader of the file refuses it later
    red, green, *_ = planes = np.moveaxis(sample, -1, 0)
    x_in_alpha = len(planes) == 4 and _is_extreme(red) and not _is_extreme(planes[3])
    if x_in_alpha:
        values, sample = values[..., [3, 1, 2]], sample[..., [3, 1, 2]]
    elif np.abs(red - green).max() < _MAX_CONSTANT_DIFFERENCE and not _is_constant(red):
        raise ValueError(
            f"{source}: red and green are equal, expected x and y of normals; it holds heights, or x in alpha: export "
            "it as RGB."
        )
    elif _is_extreme(red) or _is_extreme(green):
        name, plane = ("red", red) if _is_extreme(red) else ("green", green)
        raise ValueError(
            f"{source}: {name} is {255 * plane.mean():.0f} of 255 all over, expected x and y of normals in red and "
            "green; export it as RGB."
        )
    values, sample = values[..., :3], sample[..., :3]
    is_plane = _is_constant(red) and _is_constant(green) and _is_constant(sample[..., 2])
    # a plane has one direction, which may have any length
    if is_plane and not x_in_alpha and sample[..., 2].mean() > _MAX_CONSTANT_DIFFERENCE:
        return values
    blue_z, unit_z = np.abs(sample[..., 2] * 2 - 1), _unit_normal_z(sample)
    error = float(np.abs(blue_z - unit_z).mean())
    deviation = float(np.abs(unit_z - np.median(unit_z)).mean())
    if not (x_in_alpha or _is_constant(blue_z) or error > max(_MIN_Z_ERROR, _MIN_Z_ERROR_DEVIATIONS * deviation)):
        return values
    squared_lengths = np.square(sample[..., :2] * 2 - 1).sum(-1)
    if (long_share := float((squared_lengths > _MAX_SQUARED_LENGTH).mean())) > _MAX_LONG_SHARE:
        raise ValueError(
            f"{source}: x^2 + y^2 of red and green is above 1 in {long_share:.0%} of the px, expected normals (0..1 "
            "for -1..1); export the normals again, or leave the map out."
        )
    if x_in_alpha:
        warnings.warn(f"{source}: red is constant, x is taken from alpha, z = sqrt(1 - x^2 - y^2).", stacklevel=2)
    elif float(np.abs(sample[..., 2] * 2 - 1 - unit_z).max()) > _MIN_REPORTED_CHANGE:
        found = f"{255 * sample[..., 2].mean():.0f} of 255 all over" if _is_constant(blue_z) else "not their z"
        warnings.warn(f"{source}: blue of the normals is {found}, taken instead: sqrt(1 - x^2 - y^2).", stacklevel=2)
    return _rebuild_z(values)


def _is_constant(plane: Floats) -> bool:
    """Tell whether a channel has one value all over, but for JPEG's noise."""
    return float(np.abs(plane - plane.mean()).max()) < _MAX_CONSTANT_DIFFERENCE


def _is_extreme(plane: Floats) -> bool:
    """Tell whether a channel is 0 or 1 all over."""
    return _is_constant(plane) and not _EXTREME_RANGE < float(plane.mean()) < 1 - _EXTREME_RANGE


def _unit_normal_z(stored: Floats) -> Floats:
    """Return z >= 0 of unit normals whose x and y are stored in red and green, 0..1 for -1..1."""
    z: Floats = np.sqrt((1 - np.square(stored[..., :2] * 2 - 1).sum(-1)).clip(0))
    return z


def _rebuild_z(values: Array) -> Array:
    """Return normals [H, W, 3] with the z of unit normals in blue, as exact as the type of the values allows."""
    result = values.copy()
    largest = np.iinfo(values.dtype).max if values.dtype.kind == "u" else 0
    for row in range(0, len(values), _ROWS_AT_ONCE):
        stored = _unit_normal_z(integers_to_unit_range(values[row : row + _ROWS_AT_ONCE])) / 2 + 0.5
        result[row : row + _ROWS_AT_ONCE, :, 2] = (stored * largest).round() if largest else stored
    return result
