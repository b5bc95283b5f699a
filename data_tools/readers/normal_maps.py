"""Normal maps as programs store them: z in blue, or left out, or x in alpha, as texture compression does.

A file of two channels (BC5, red and green), or one whose blue holds something else, such as 255 all over, has the z of
unit normals all the same: sqrt(1 - x^2 - y^2). Files of DXT5nm have x in alpha, and red is 255 all over.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from data_tools.readers.colours import Array, Floats, integers_to_unit_range

_SAMPLES = 2**20  # px that tell
_ROWS = 256  # rebuilt at a time: floats of a whole map take over a hundred megabytes
_LEVEL = 1.5 / 255  # by which a channel that is constant differs from its mean
_EXTREME = 0.02  # of 0 or 1: x = 1 all over is no surface
_MOST_LONG = 0.01  # share of px whose x and y are too long for a unit normal; at most 0.001 of 461 published maps
_TOO_LONG = 1.05
# Mean difference of blue and the z of unit normals: least one that matters, and in mean absolute deviations of z, at
# most 0.6 in 461 published maps and at least 0.8 where blue is constant, in JPEG, too, or holds another map.
_LEAST_ERROR, _LARGEST_ERROR = 0.01, 0.7
_SHOWN = 0.05  # change of z that a line is said of


def complete_normals(values: Array, source: Path) -> Array:
    """Return normals of three channels, whose blue is z, of a file's channels; a line says what was rebuilt.

    Args:
        values: [H, W, 3], or 4 with alpha last, integers or floats of 0..1 for -1..1.
        source: begins messages.

    Raises:
        ValueError: red and green are the x and y of no normals: equal, constant at -1 or 1, or longer than 1.
    """
    step = max(1, round((values.shape[0] * values.shape[1] / _SAMPLES) ** 0.5))
    sample = integers_to_unit_range(values[::step, ::step])
    if not np.isfinite(sample).all():
        return values[..., :3]  # its reader says so
    red, green, *_ = planes = np.moveaxis(sample, -1, 0)
    x_in_alpha = len(planes) == 4 and _is_extreme(red) and not _is_extreme(planes[3])
    if x_in_alpha:
        values, sample = values[..., [3, 1, 2]], sample[..., [3, 1, 2]]
    elif np.abs(red - green).max() < _LEVEL and not _is_constant(red):
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
    if is_plane and not x_in_alpha and sample[..., 2].mean() > _LEVEL:  # of one direction, which may be of any length
        return values
    blue, height = np.abs(sample[..., 2] * 2 - 1), _heights(sample)
    error = float(np.abs(blue - height).mean())
    deviation = float(np.abs(height - np.median(height)).mean())
    if not (x_in_alpha or _is_constant(blue) or error > max(_LEAST_ERROR, _LARGEST_ERROR * deviation)):
        return values
    lengths = np.square(sample[..., :2] * 2 - 1).sum(-1)
    if (share := float((lengths > _TOO_LONG).mean())) > _MOST_LONG:
        raise ValueError(
            f"{source}: x^2 + y^2 of red and green is above 1 in {share:.0%} of the px, expected normals (0..1 for "
            "-1..1); it holds something else."
        )
    if x_in_alpha:
        warnings.warn(f"{source}: red is constant, x is taken from alpha, z = sqrt(1 - x^2 - y^2).", stacklevel=2)
    elif float(np.abs(sample[..., 2] * 2 - 1 - height).max()) > _SHOWN:
        found = f"{255 * sample[..., 2].mean():.0f} of 255 all over" if _is_constant(blue) else "not their z"
        warnings.warn(f"{source}: blue of the normals is {found}, taken instead: sqrt(1 - x^2 - y^2).", stacklevel=2)
    return _with_heights(values)


def _is_constant(plane: Floats) -> bool:
    return float(np.abs(plane - plane.mean()).max()) < _LEVEL


def _is_extreme(plane: Floats) -> bool:
    """Test whether a channel is 0 or 1 all over."""
    return _is_constant(plane) and not _EXTREME < float(plane.mean()) < 1 - _EXTREME


def _heights(stored: Floats) -> Floats:
    """Return z >= 0 of unit normals whose x and y are stored in red and green, 0..1 for -1..1."""
    heights: Floats = np.sqrt((1 - np.square(stored[..., :2] * 2 - 1).sum(-1)).clip(0))
    return heights


def _with_heights(values: Array) -> Array:
    """Return normals [H, W, 3] with the z of unit normals in blue, as exact as the type of the values allows."""
    result = values.copy()
    largest = np.iinfo(values.dtype).max if values.dtype.kind == "u" else 0
    for row in range(0, len(values), _ROWS):
        stored = _heights(integers_to_unit_range(values[row : row + _ROWS])) / 2 + 0.5
        result[row : row + _ROWS, :, 2] = (stored * largest).round() if largest else stored
    return result
