"""The angles of a goniometer table as directions of light and detector, by whichever angles its columns hold.

A table holds one of three sets of angles: those of both directions; both polar angles and the azimuth between the
directions; or half and difference angles (Rusinkiewicz).
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from data_tools.readers.numbers import Doubles
from metapp.appearance.geometry import rusinkiewicz_to_directions

ANGLE_COLUMNS = ("theta_i", "phi_i", "theta_o", "phi_o")
HALF_COLUMNS = ("theta_h", "theta_d", "phi_d")  # phi_h is optional
RELATIVE_AZIMUTH_COLUMN = "phi"  # azimuth of the detector from the light
RADIANS_PER_UNIT = {"deg": math.pi / 180, "rad": 1.0}
# Azimuths in a column of degrees are taken for radians if they fill a half or a full circle in radians. A full circle
# in steps of 45 degrees ends at 0.875 of it.
MIN_CIRCLE_SHARE = 0.87
MIN_FILLING_AZIMUTHS = 6  # number of different azimuths below which they do not fill a circle
AZIMUTH_STEP_DEGREES = 0.05  # azimuths of which most are multiples of it are degrees

_DIRECTION_WORDS = {
    "i": ("i", "in", "inc", "incident", "incoming", "l", "light"),
    "o": ("o", "out", "outgoing", "r", "refl", "reflected", "v", "view", "viewer", "detector"),
    "h": ("h", "half"),
    "d": ("d", "diff", "difference"),
}
_DIRECTION_BY_WORD = {word: direction for direction, words in _DIRECTION_WORDS.items() for word in words}
_UNIT_WORDS = {"deg": "deg", "degree": "deg", "degrees": "deg", "rad": "rad", "radian": "rad", "radians": "rad"}
_ANGLE_NAME = re.compile(
    rf"(theta|phi)[ _]?({'|'.join(_DIRECTION_BY_WORD)})(?:[ _]({'|'.join(_UNIT_WORDS)}))?"
    rf"|(?:phi|dphi|delta[ _]?phi)(?:[ _]({'|'.join(_UNIT_WORDS)}))?"
)


def name_angle(name: str) -> str:
    """Return the name under which an angle is read, such as theta_i_deg for thetaI_degrees; "" if it is no angle.

    >>> name_angle("theta_in"), name_angle("phi_out_radians"), name_angle("dphi_deg"), name_angle("r")
    ('theta_i', 'phi_o_rad', 'phi_deg', '')
    """
    if not (match := _ANGLE_NAME.fullmatch(name.lower())):
        return ""
    angle = f"{match[1]}_{_DIRECTION_BY_WORD[match[2]]}" if match[1] else RELATIVE_AZIMUTH_COLUMN
    unit = match[3] or match[4]
    return f"{angle}_{_UNIT_WORDS[unit]}" if unit else angle


def read_directions(path: Path, columns: Mapping[str, Doubles], lines: Sequence[int]) -> tuple[Tensor, Tensor]:
    """Return unit vectors to light and detector, [N, 3] each, of all rows; half angles may lead below the surface.

    A warning says so if a table has the azimuth between the directions alone.

    Args:
        path: the file, which errors name.
        columns: columns [N] by name, as :func:`name_angle` returns it.
        lines: the line number of each row.

    Raises:
        ValueError: an angle has no column, two columns or no unit, or it leaves its range or cannot be in its unit.
    """
    given = {name.removesuffix("_deg").removesuffix("_rad") for name in columns}
    if given >= {"theta_h", "theta_d"} and not given >= {"theta_i", "theta_o"}:
        names = (*HALF_COLUMNS, *(["phi_h"] if "phi_h" in given else []))
        angles = _read_angles(path, columns, lines, names)
        return rusinkiewicz_to_directions(torch.from_numpy(np.stack([angles[name] for name in names], 1)))
    azimuth = next((name for name in (RELATIVE_AZIMUTH_COLUMN, "phi_o") if name in given), "")
    if given >= {"theta_i", "theta_o"} and azimuth and "phi_i" not in given and not {"phi", "phi_o"} <= given:
        angles = _read_angles(path, columns, lines, ("theta_i", "theta_o", azimuth))
        angles |= {"phi_i": np.zeros(len(lines)), "phi_o": angles[azimuth]}
        warnings.warn(
            f"{path}: three angles, theta_i, theta_o and {azimuth}: phi_i is taken as 0, so that the mirror direction "
            f"is at {azimuth} = 180 degrees",
            stacklevel=2,
        )
    else:
        angles = _read_angles(path, columns, lines, ANGLE_COLUMNS)
    light, detector = (
        torch.from_numpy(_unit_vectors(angles[f"theta_{direction}"], angles[f"phi_{direction}"]))
        for direction in ("i", "o")
    )
    return light, detector


def _read_angles(
    path: Path, columns: Mapping[str, Doubles], lines: Sequence[int], names: Sequence[str]
) -> dict[str, Doubles]:
    """Return the angles of some names in rad, [N] each; thetas are in [-pi/2, pi/2]. Raises ValueError as above."""
    angles = {name: _read_angle(path, columns, lines, name) for name in names}
    in_degrees = {name: columns[f"{name}_deg"] for name in names if f"{name}_deg" in columns}
    thetas = {name: values for name, values in in_degrees.items() if name.startswith("theta")}
    azimuths = {name: values for name, values in in_degrees.items() if name.startswith("phi")}
    theta_names = [name for name in names if name.startswith("theta")]
    if len(thetas) == len(theta_names) and 0 < _largest(thetas) <= math.pi / 2 + 0.01:
        _refuse_radians(path, thetas, "degrees over the hemisphere, up to about 90")
    if azimuths and _fill_circle_of_radians(np.concatenate([*azimuths.values()])):
        _refuse_radians(path, azimuths, "degrees, up to 180 or 360")
    return angles


def _largest(values: Mapping[str, Doubles]) -> float:
    """Return the largest absolute value of some columns [N]."""
    return max(float(np.abs(column).max(initial=0)) for column in values.values())


def _fill_circle_of_radians(azimuths: Doubles) -> bool:
    """Tell whether azimuths [N] of a column of degrees fill a half or a full circle in radians."""
    sizes = np.unique(np.abs(azimuths[azimuths != 0]))
    if len(sizes) < MIN_FILLING_AZIMUTHS:
        return False
    steps = sizes / AZIMUTH_STEP_DEGREES
    are_round = np.mean(np.abs(steps - np.round(steps)) < 1e-6) > 0.5
    is_filled = any(MIN_CIRCLE_SHARE * circle <= sizes[-1] <= circle + 0.01 for circle in (math.pi, math.tau))
    return bool(is_filled and not are_round)


def _refuse_radians(path: Path, columns: Mapping[str, Doubles], expected: str) -> None:
    """Raise ValueError for columns of degrees by name that hold radians."""
    renamed = ", ".join(f"{name}_rad" for name in columns)
    raise ValueError(
        f"{path}: {', '.join(f'{name}_deg' for name in columns)} up to {_largest(columns):.4g}, expected {expected}; "
        f"they look like radians: rename the columns to {renamed}."
    )


def _read_angle(path: Path, columns: Mapping[str, Doubles], lines: Sequence[int], name: str) -> Doubles:
    """Return the angle of a name, such as theta_i, of all rows, in rad, [N]; thetas are in [-pi/2, pi/2].

    Raises:
        ValueError: no column or two columns hold the angle, or it leaves its range.
    """
    stated_units = [unit for unit in RADIANS_PER_UNIT if f"{name}_{unit}" in columns]
    if len(stated_units) != 1:
        found = f"no such column among {', '.join(repr(column[:20]) for column in [*columns][:8])}"
        problem, remedy = ("no unit", "rename it") if name in columns else (found, "add or rename it")
        if stated_units:
            problem, remedy = "both units", "remove one of them"
        raise ValueError(f"{path}: {name}: {problem}, expected the column {name}_deg or {name}_rad; {remedy}.")
    values, unit = columns[f"{name}_{stated_units[0]}"], RADIANS_PER_UNIT[stated_units[0]]
    limit_rad = math.pi / 2 if name.startswith("theta") else 2 * math.tau
    is_bad = ~(np.abs(values * unit) <= limit_rad + 1e-6)
    if is_bad.any():
        row = int(is_bad.argmax())
        remedy = "leave out directions below the surface" if name.startswith("theta") else "check the unit"
        if stated_units[0] == "rad" and np.nanmax(np.abs(values)) > limit_rad + math.pi / 2:
            remedy = f"if these are degrees, rename the column to {name}_deg"
        raise ValueError(
            f"{path}: line {lines[row]}: {name} {values[row]:.6g} {stated_units[0]}, expected {-limit_rad / unit:.6g} "
            f"to {limit_rad / unit:.6g}; {remedy}."
        )
    result: Doubles = values * unit
    return result


def _unit_vectors(theta: Doubles, phi: Doubles) -> Doubles:
    """Return unit vectors [N, 3] of spherical angles [N] in rad; a negative theta points to phi + pi."""
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
