"""The angles of a goniometer table as directions of light and detector, by whichever angles its columns hold.

A table holds one of two sets of angles: those of both directions, or half and difference angles (Rusinkiewicz). Of each
direction the polar angle is from the normal (theta), or from the surface (elevation). The azimuth of the detector is
absolute (phi_o), from the light (phi), or from the mirror direction (phi_mirror); that of the light is 0 if left out.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from data_tools.readers.numbers import Doubles
from metapp.appearance.geometry import rusinkiewicz_to_directions

ANGLE_COLUMNS = ("theta_i", "phi_i", "theta_o", "phi_o")
HALF_COLUMNS = ("theta_h", "theta_d", "phi_d")  # phi_h is optional
RELATIVE_COLUMN, MIRROR_COLUMN = "phi", "phi_mirror"  # azimuth of the detector from the light, or from its mirror image
DETECTOR_AZIMUTHS = ("phi_o", RELATIVE_COLUMN, MIRROR_COLUMN)
RADIANS_PER_UNIT = {"deg": math.pi / 180, "rad": 1.0}
# Azimuths in a column of degrees are taken for radians if they fill a half or a full circle in radians. A full circle
# in steps of 45 degrees ends at 0.875 of it.
MIN_CIRCLE_SHARE = 0.87
MIN_FILLING_AZIMUTHS = 6  # number of different azimuths below which they do not fill a circle
AZIMUTH_STEP_DEGREES = 0.05  # angles of which most are multiples of it are degrees
# Angles in a column of degrees are radians, too, if all of them are such multiples once they are converted. Those that
# are written to four digits are off by up to 0.003 degrees, which one in eighty of any angles is by chance.
RADIAN_STEP_DEGREES, RADIAN_TOLERANCE_DEGREES = 0.5, 0.003

_KIND_WORDS = {
    "theta": ("theta", "zenith", "polar"),
    "phi": ("phi", "azimuth", "azim", "azi", "az"),
    "elevation": ("elevation", "elev", "el", "altitude", "alt"),
}
_DIRECTION_WORDS = {
    "i": ("i", "in", "inc", "incident", "incidence", "incoming", "l", "light", "source", "illumination", "sun",
          "solar"),
    "o": ("o", "out", "outgoing", "r", "refl", "reflected", "reflection", "v", "view", "viewer", "viewing", "detector",
          "sensor", "observer"),
    "h": ("h", "half"),
    "d": ("d", "diff", "difference"),
    "": ("", "rel", "relative", "delta"),
    "mirror": ("mirror", "specular", "spec"),
}  # fmt: skip
_KIND_BY_WORD = {word: kind for kind, words in _KIND_WORDS.items() for word in words}
_DIRECTION_BY_WORD = {word: direction for direction, words in _DIRECTION_WORDS.items() for word in words}
_UNIT_WORDS = {"deg": "deg", "degree": "deg", "degrees": "deg", "rad": "rad", "radian": "rad", "radians": "rad"}
_ANGLES = {*ANGLE_COLUMNS, *HALF_COLUMNS, "phi_h", RELATIVE_COLUMN, MIRROR_COLUMN, "elevation_i", "elevation_o"}


class AngleTable(NamedTuple):
    """The columns of a table.

    Attributes:
        columns: values [N] by name; of an angle the name is as :func:`name_angle` returns it.
        titles: the same columns' names as the file has them.
        lines: the line number of each of the N rows.
    """

    columns: Mapping[str, Doubles]
    titles: Mapping[str, str]
    lines: Sequence[int]


class SphericalAngles(NamedTuple):
    """The spherical angles of light and detector as a table states them, and how it states them.

    Attributes:
        angles: theta_i, phi_i, theta_o and phi_o in rad, [N, 4]; a negative theta is at phi + pi.
        columns: the columns of the polar angles of light and detector and of the detector's azimuth, such as theta_i,
            elevation_o and phi_mirror.
        titles: the name in the file of each column.
        units: the unit of each column: deg or rad.
    """

    angles: Doubles
    columns: tuple[str, str, str]
    titles: Mapping[str, str]
    units: Mapping[str, str]

    def directions(self) -> tuple[Tensor, Tensor]:
        """Return unit vectors to light and detector, [N, 3] each."""
        theta_i, phi_i, theta_o, phi_o = self.angles.T
        light, detector = spherical_to_directions(theta_i, phi_i), spherical_to_directions(theta_o, phi_o)
        return torch.from_numpy(light), torch.from_numpy(detector)


def name_angle(name: str) -> str:
    """Return the name under which an angle is read, such as theta_i_deg for thetaI_degrees; "" if it is no angle.

    >>> name_angle("theta_in"), name_angle("viewZenith_deg"), name_angle("dphi_deg"), name_angle("r")
    ('theta_i', 'theta_o_deg', 'phi_deg', '')
    """
    spaced_name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()
    spaced_name = re.sub(r"^(theta|phi)(?=[a-z])", r"\1_", re.sub(r"^d(?=phi|azimuth)", "delta_", spaced_name))
    words = [word for word in re.split(r"[ _.-]+", spaced_name) if word and word not in ("angle", "from")]
    unit = f"_{_UNIT_WORDS[words.pop()]}" if words and words[-1] in _UNIT_WORDS else ""
    first, second = (*words, "") if len(words) == 1 else words if len(words) == 2 else ("?", "?")
    if first not in _KIND_BY_WORD:
        first, second = second, first
    if first not in _KIND_BY_WORD or second not in _DIRECTION_BY_WORD:
        return ""
    angle = "_".join(filter(None, (_KIND_BY_WORD[first], _DIRECTION_BY_WORD[second])))
    return f"{angle}{unit}" if angle in _ANGLES else ""


def read_directions(path: Path, table: AngleTable) -> SphericalAngles | tuple[Tensor, Tensor]:
    """Read the directions of all rows.

    A warning says so if a table has no azimuth of the light, and does not say what the detector's is counted from.

    Args:
        path: the file, which errors name.
        table: its columns.

    Returns:
        The angles of light and detector; of a table of half and difference angles unit vectors to light and detector,
        [N, 3] each, which may lead below the surface.

    Raises:
        ValueError: an angle has no column, two columns or no unit, or it leaves its range or cannot be in its unit.
    """
    given = {name.removesuffix("_deg").removesuffix("_rad") for name in table.columns}
    polar_names = tuple(
        f"elevation_{direction}" if f"elevation_{direction}" in given - {f"theta_{direction}"} else f"theta_{direction}"
        for direction in ("i", "o")
    )
    if given >= {"theta_h", "theta_d"} and not given >= {*polar_names}:
        names = (*HALF_COLUMNS, *(["phi_h"] if "phi_h" in given else []))
        angles = _read_angles(path, table, names)
        return rusinkiewicz_to_directions(torch.from_numpy(np.stack([angles[name] for name in names], 1)))
    azimuths = [name for name in DETECTOR_AZIMUTHS if name in given]
    has_light_azimuth = "phi_i" in given or len(azimuths) != 1  # of two azimuths none is said to be the detector's
    azimuth = azimuths[0] if azimuths else "phi_o"
    light_azimuths = ["phi_i"] if has_light_azimuth else []
    angles = _read_angles(path, table, (*polar_names, *light_azimuths, azimuth))
    titles = {name: _title(table, name) for name in angles}
    if not has_light_azimuth and azimuth != MIRROR_COLUMN:
        found = f"three angles, {', '.join(titles[name] for name in (*polar_names, azimuth))}"
        warnings.warn(
            f"{path}: {found}: phi_i is taken as 0, so that the mirror direction is at {titles[azimuth]} = 180 degrees",
            stacklevel=2,
        )
    theta_i, theta_o = (
        math.pi / 2 - angles[name] if name.startswith("elevation") else angles[name] for name in polar_names
    )
    phi_i = angles.get("phi_i", np.zeros(len(table.lines)))
    phi_o = absolute_azimuth(azimuth, angles[azimuth], phi_i)
    columns = (polar_names[0], polar_names[1], azimuth)
    units = {name: "deg" if f"{name}_deg" in table.columns else "rad" for name in angles}
    return SphericalAngles(np.stack([theta_i, phi_i, theta_o, phi_o], 1), columns, titles, units)


def absolute_azimuth(name: str, values: Doubles, phi_i: Doubles) -> Doubles:
    """Return the azimuth of the detector as phi_o, [N] in rad.

    Args:
        name: the column that states it: one of DETECTOR_AZIMUTHS.
        values: the values of this column, [N] in rad.
        phi_i: the azimuth of the light, [N] in rad.
    """
    if name == "phi_o":
        return values
    return phi_i + values if name == RELATIVE_COLUMN else phi_i + math.pi + values


def _read_angles(path: Path, table: AngleTable, names: Sequence[str]) -> dict[str, Doubles]:
    """Return the angles of some names in rad, [N] each. Raises ValueError as above."""
    angles = {name: _read_angle(path, table, name) for name in names}
    in_degrees = {name: table.columns[f"{name}_deg"] for name in names if f"{name}_deg" in table.columns}
    polar = {name: values for name, values in in_degrees.items() if not name.startswith("phi")}
    azimuths = {name: values for name, values in in_degrees.items() if name.startswith("phi")}
    polar_names = [name for name in names if not name.startswith("phi")]
    are_small = all(_largest({name: polar[name]}) <= _polar_range(name)[1] + 0.01 for name in polar)
    if len(polar) == len(polar_names) and are_small and _largest(polar) > 0:
        _refuse_radians(path, table, polar, "degrees over the hemisphere, up to about 90")
    for columns in filter(None, (azimuths, *({name: values} for name, values in in_degrees.items()))):
        if _are_radians(np.concatenate([*columns.values()]), _circles_rad(next(iter(columns)))):
            expected = "degrees, up to 180 or 360" if columns.keys() <= azimuths.keys() else "degrees, up to about 90"
            _refuse_radians(path, table, columns, expected)
    return angles


def _circles_rad(name: str) -> tuple[float, ...]:
    """Return the greatest values in rad of an angle that is measured all around; none of half and difference angles."""
    if name in ("theta_h", "theta_d"):  # these may well be small
        return ()
    return (math.pi, math.tau) if name.startswith("phi") else (math.pi / 2, *_polar_range(name)[1:])


def _polar_range(name: str) -> tuple[float, float]:
    """Return the least and the greatest value of theta or of elevation, in rad; both lead over the whole sky."""
    return (0.0, math.pi) if name.startswith("elevation") else (-math.pi / 2, math.pi / 2)


def _largest(values: Mapping[str, Doubles]) -> float:
    """Return the largest absolute value of some columns [N]."""
    return max(float(np.abs(column).max(initial=0)) for column in values.values())


def _are_radians(values: Doubles, circles_rad: tuple[float, ...]) -> bool:
    """Tell whether a column of degrees holds radians, which are whole degrees if they are converted, or fill a circle.

    Args:
        values: the angles, [N].
        circles_rad: see :func:`_circles_rad`.
    """
    sizes = np.unique(np.abs(values[values != 0]))
    is_large = len(sizes) > 0 and sizes[-1] > max(circles_rad, default=math.pi / 2) + 0.01
    if len(sizes) < 2 or is_large or _share_of_multiples(sizes, AZIMUTH_STEP_DEGREES) > 0.5:
        return False
    if _share_of_multiples(np.degrees(sizes), RADIAN_STEP_DEGREES, RADIAN_TOLERANCE_DEGREES) == 1:
        return True
    fills = any(MIN_CIRCLE_SHARE * circle <= sizes[-1] <= circle + 0.01 for circle in circles_rad)
    return fills and len(sizes) >= MIN_FILLING_AZIMUTHS


def _share_of_multiples(values: Doubles, step: float, tolerance: float = 0.0) -> float:
    """Return the share of values [N] that are multiples of a step, within rounding or a larger tolerance."""
    return float(np.mean(np.abs(values - step * np.round(values / step)) <= max(tolerance, 1e-6 * step)))


def _refuse_radians(path: Path, table: AngleTable, columns: Mapping[str, Doubles], expected: str) -> None:
    """Raise ValueError for columns of degrees by name that hold radians."""
    renamed = ", ".join(f"{name}_rad" for name in columns)
    raise ValueError(
        f"{path}: {', '.join(_title(table, name) for name in columns)} up to {_largest(columns):.4g}, expected "
        f"{expected}; they look like radians: rename the columns to {renamed}."
    )


def _title(table: AngleTable, name: str) -> str:
    """Return the name that the file has for an angle, such as theta_in [deg] for theta_i."""
    return next((table.titles[key] for key in (f"{name}_deg", f"{name}_rad", name) if key in table.titles), name)


def _read_angle(path: Path, table: AngleTable, name: str) -> Doubles:
    """Return the angle of a name, such as theta_i, of all rows, in rad, [N].

    Raises:
        ValueError: no column or two columns hold the angle, or it leaves its range.
    """
    title = _title(table, name)
    stated_units = [unit for unit in RADIANS_PER_UNIT if f"{name}_{unit}" in table.columns]
    if name in table.columns and not stated_units:
        name_in_file = title.replace("(", "[").partition("[")[0].strip()
        expected = f"the column {name_in_file}_deg or {name_in_file}_rad"
        raise ValueError(f"{path}: {title}: no unit, expected {expected}; rename it.")
    if len(stated_units) != 1:
        found = f"no such column among {', '.join(repr(column[:20]) for column in [*table.titles.values()][:8])}"
        expected = f"the column {name}_deg or {name}_rad"
        if name in ("theta_i", "theta_o"):
            expected += f", from the normal, or {name.replace('theta', 'elevation')}_deg or _rad, from the surface"
        problem, remedy = ("both units", "remove one of them") if stated_units else (found, "add or rename it")
        raise ValueError(f"{path}: {name}: {problem}, expected {expected}; {remedy}.")
    values, unit = table.columns[f"{name}_{stated_units[0]}"], RADIANS_PER_UNIT[stated_units[0]]
    low, high = (-2 * math.tau, 2 * math.tau) if name.startswith("phi") else _polar_range(name)
    is_bad = ~((values * unit >= low - 1e-6) & (values * unit <= high + 1e-6))
    if is_bad.any():
        row = int(is_bad.argmax())
        remedy = "check the unit" if name.startswith("phi") else "leave out directions below the surface"
        if stated_units[0] == "rad" and np.nanmax(np.abs(values)) > high + math.pi / 2:
            remedy = f"if these are degrees, rename the column to {name}_deg"
        elif name in ("theta_i", "theta_o"):
            if (values * unit >= high - 1e-6).all():
                remedy = "subtract them from 180 degrees if these are of the direction in which light travels"
            remedy += f", or, if angles are from the surface, rename it to {name.replace('theta', 'elevation')}_deg"
        raise ValueError(
            f"{path}: line {table.lines[row]}: {title.removesuffix(f'_{stated_units[0]}')} {values[row]:.6g} "
            f"{stated_units[0]}, expected {low / unit:.6g} to {high / unit:.6g}; {remedy}."
        )
    result: Doubles = values * unit
    return result


def spherical_to_directions(theta: Doubles, phi: Doubles) -> Doubles:
    """Return unit vectors [N, 3] of spherical angles [N] in rad; a negative theta points to phi + pi."""
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
