"""Gonioreflectometer measurements as CSV: one pair of directions a row, with its BRDF.

A line of column names, perhaps one of units, then numbers; lines that begin with # are comments. `theta_i, phi_i` is
the light, `theta_o, phi_o` the detector, with the unit behind, `theta_i_deg` or `theta_i_rad`, or below; thetas from
the normal, negative ones at phi + 180 degrees. The BRDF in 1/sr is `r, g, b`, linear RGB, or columns of wavelengths,
`400nm, 410nm, ...`, which become linear RGB of the material in D65. Columns stand in any order; others are passed over.
UTF-8 or UTF-16; between cells stand commas, semicolons, tabs or bars, as Excel's line `sep=;` or the
names tell; cells may be in quotes, and decimal commas stand beside another sign or in quotes.
"""

from __future__ import annotations

import contextlib
import csv
import functools
import io
import itertools
import math
import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_tools.readers import brdf_task
from data_tools.readers.input_source import ANISOTROPIC_FACT, DAMAGED_FACT, SAMPLE_COUNT_FACT, Source, Sources
from data_tools.readers.listing import find_by_suffix, has_suffix
from data_tools.readers.measured_pairs import MAX_REFLECTANCE_PER_SR, MeasuredPairs, depends_on_azimuth, task_of_pairs
from metapp.appearance.colorimetry import spectrum_to_rgb_matrix
from metapp.appearance.geometry import directions_to_four_angles
from metapp.learning.task import Task
from metapp.storage.files import open_text, write_bytes

Doubles = NDArray[np.float64]

GONIO_SUFFIX = ".csv"
ANGLE_COLUMNS = ("theta_i", "phi_i", "theta_o", "phi_o")
UNITS = {key: unit for key, unit in brdf_task.UNITS.items() if key != "environment"}
RADIANS_PER_UNIT = {"deg": math.pi / 180, "rad": 1.0}
RGB_COLUMNS = ("r", "g", "b")
VISIBLE_RANGE_NM = (420.0, 680.0)  # nm, that spectra must cover
MAX_KEPT_TABLE_BYTES = 1 << 26  # of parsed tables; those of a larger folder are parsed again when their turn comes
MAX_TABLE_BYTES = 1 << 28  # bytes of a file
MAX_NOISE_PER_SR = 1e-3  # 1/sr; what is no further below 0 is noise

_LINE = 1 << 20  # characters of a line
_SEPARATORS = ",;\t|"
_UNITS = {"deg": "_deg", "degree": "_deg", "degrees": "_deg", "°": "_deg", "rad": "_rad", "radian": "_rad",
          "radians": "_rad", "nm": "nm"}  # fmt: skip
_WAVELENGTH = re.compile(r"(\d{3,4}(?:\.\d+)?)\s*nm")

recognises = functools.partial(has_suffix, suffix=GONIO_SUFFIX)


def find(path: Path) -> Sources:
    """Find tables and parse them, as each will be fitted; of a damaged one reading it says what is wrong."""
    files, skipped = find_by_suffix(path, GONIO_SUFFIX, "a .csv file of a goniometer")
    sources, kept = [], 0
    for file in files:
        try:
            pairs = read_pairs(file)
        except (ValueError, OSError):
            sources.append(Source(file.stem, file, facts={DAMAGED_FACT: True}))
            continue
        azimuths = depends_on_azimuth(directions_to_four_angles(pairs.wi, pairs.wo), pairs.reflectance)
        facts = {ANISOTROPIC_FACT: azimuths, SAMPLE_COUNT_FACT: len(pairs.wi)}
        kept += sum(values.nbytes for values in pairs)
        sources.append(Source(file.stem, file, facts=facts, content=pairs if kept <= MAX_KEPT_TABLE_BYTES else None))
    return sources, skipped


def read_task(path: Path, content: MeasuredPairs | None = None) -> Task:
    """Turn measurements into a BRDF task, named by the file's stem, as `task_of_pairs` says.

    Args:
        path: the file.
        content: its measurements, as `find` has parsed them.

    Raises:
        ValueError: as `read_pairs`; too few measurements.
    """
    return task_of_pairs(path.stem, content or read_pairs(path), path)


def read_pairs(path: Path) -> MeasuredPairs:
    """Read a file; rows along or below the surface are left out.

    Raises:
        ValueError: no such table: missing columns, rows that are no numbers, negative or huge values, angles beyond
            their range.
    """
    columns, lines = _rows(path)
    angles = np.stack([_angle(path, columns, lines, name) for name in ANGLE_COLUMNS], 1)
    names, matrix = _colours(path, list(columns))
    values = np.stack([columns[name] for name in names], 1)
    bad = ~((values >= -MAX_NOISE_PER_SR) & (values <= MAX_REFLECTANCE_PER_SR))
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise ValueError(
            f"{path}: line {lines[row]}: {names[column]} {values[row, column]:.6g}, expected 0 to "
            f"{MAX_REFLECTANCE_PER_SR:g} in 1/sr; fill in what a plan asks for, and leave out rows that were not measured."
        )
    if count := int((values < 0).sum()):
        found = f"{count:,} of {values.size:,} values below 0, down to {values.min():.3g} /sr"
        warnings.warn(f"{path}: {found}, expected 0 or more; taken for noise and set to 0", stacklevel=2)
    if not values.any():
        warnings.warn(f"{path}: reflectance 0 everywhere, expected some light reflected; is it damaged?", stacklevel=2)
    light, viewer = (torch.from_numpy(_direction(angles[:, i], angles[:, i + 1])) for i in (0, 2))
    return MeasuredPairs(light, viewer, torch.from_numpy(values @ matrix).clamp_min(0)).above()


def write_pairs(path: Path, wi: Tensor, wo: Tensor, before: MeasuredPairs) -> None:
    """Write a table to fill in: earlier measurements, then pairs of unit vectors [N, 3] without a BRDF."""
    lines = [
        "# the BRDF in 1/sr as linear RGB, a row a pair of directions: theta_i, phi_i light, theta_o, phi_o detector"
    ]
    lines += ["# fill in all rows; leave out those that cannot be measured"] * (len(wi) > 0)
    lines += [",".join([*(f"{name}_deg" for name in ANGLE_COLUMNS), *RGB_COLUMNS])]
    for *pair, colour in zip(before.wi, before.wo, before.reflectance.tolist(), strict=True):
        lines.append(",".join([*_degrees(*pair), *(f"{value:.6g}" for value in colour)]))
    lines += [",".join([*_degrees(*pair), "", "", ""]) for pair in zip(wi, wo, strict=True)]
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def _degrees(*vectors: Tensor) -> Iterator[str]:
    for x, y, z in (vector.tolist() for vector in vectors):
        yield from (f"{math.degrees(angle):.2f}" for angle in (math.atan2(math.hypot(x, y), z), math.atan2(y, x)))


def _rows(path: Path) -> tuple[dict[str, Doubles], list[int]]:
    """The columns of a file by name, [N] each, and the line of each row; comments are left out."""
    size = path.stat().st_size
    if size > MAX_TABLE_BYTES:
        raise ValueError(
            f"{path}: {size:,} bytes, expected at most {MAX_TABLE_BYTES:,}, some 6 million rows; keep one row in "
            f"{math.ceil(size / MAX_TABLE_BYTES)}."
        )
    try:
        with open_text(path) as text:
            rows = list(_lines(path, text))
    except UnicodeDecodeError:
        raise ValueError(f"{path}: no text in UTF-8 or UTF-16, expected a table of numbers; save it as CSV.") from None
    told = re.fullmatch(r'"?sep=(.)"?', rows[0][1].rstrip("\r\n"), re.IGNORECASE) if rows else None
    rows = rows[1:] if told else rows
    if not rows:
        raise ValueError(f"{path}: no rows, expected a line of column names and rows of numbers.")
    separator = told[1] if told else max(_SEPARATORS, key=rows[0][1].count)
    names = _words(rows.pop(0)[1].lower(), separator)
    below = _words(rows[0][1].lower(), separator) if rows else []
    units = [word.strip("[]() ") for word in below] if not any(map(_is_number, below)) else []
    rows = rows[1:] if units else rows
    names = [_named(*pair) for pair in itertools.zip_longest(names, units[: len(names)], fillvalue="")]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{path}: two columns {_shown(twice)}, expected names that differ; rename one.")
    if not rows:
        raise ValueError(f"{path}: no rows below the column names, expected a row of numbers a measurement; add them.")
    plain = (line if separator == "," else line.replace(",", ".") for _, line in rows)
    numbers = np.empty((0, 0))
    with contextlib.suppress(ValueError):  # ten times as fast, but of what is wrong it does not say the line
        numbers = np.loadtxt(plain, delimiter=separator, ndmin=2, quotechar='"')
    if numbers.shape != (len(rows), len(names)):
        cells = [_cells(path, at, _words(line, separator), len(names)) for at, line in rows]
        numbers = np.array(cells, np.float64).reshape(-1, len(names))
    return dict(zip(names, numbers.T, strict=True)), [at for at, _ in rows]


def _lines(path: Path, text: io.TextIOWrapper) -> Iterator[tuple[int, str]]:
    """Lines with something in a cell, by their numbers; comments are left out."""
    for at in itertools.count(1):
        line = text.readline(_LINE + 1)
        if len(line) > _LINE:
            raise ValueError(f"{path}: line {at}: more than {_LINE:,} characters, expected a row a pair; break it.")
        if not line:
            return
        if line.strip(_SEPARATORS + '" \r\n') and line.lstrip()[0] != "#":
            yield at, line


def _words(line: str, separator: str) -> list[str]:
    with contextlib.suppress(csv.Error):  # of a cell of more characters than any number has
        return [word.strip() for word in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
    return [line]


def _named(name: str, unit: str) -> str:
    """A column's name with its unit behind, which stands in brackets or below it."""
    name, _, bracketed = name.replace("(", "[").partition("[")
    name, end = name.strip(), _UNITS.get(bracketed.strip("]) ") or unit, "")
    return name if name.endswith(end) or not (name in ANGLE_COLUMNS or end == "nm") else f"{name}{end}"


def _is_number(word: str) -> bool:
    with contextlib.suppress(ValueError):
        float(word.replace(",", "."))
        return True
    return False


def _cells(path: Path, at: int, words: list[str], count: int) -> list[float]:
    if len(words) != count:
        raise ValueError(f"{path}: line {at}: {len(words)} numbers, expected {count} as column names; put it right.")
    if bad := [word for word in words if word and not _is_number(word)]:
        raise ValueError(f"{path}: line {at}: {_shown(bad[0])}, expected a number; put it right.")
    return [float(word.replace(",", ".")) if word else math.nan for word in words]


def _shown(word: str) -> str:
    """A word of a file, short and printable, in quotes."""
    return repr(word.strip()[:30])


def _angle(path: Path, columns: dict[str, Doubles], lines: list[int], name: str) -> Doubles:
    """One of the angles in rad, [N], thetas in [-pi/2, pi/2]."""
    there = [unit for unit in RADIANS_PER_UNIT if f"{name}_{unit}" in columns]
    if len(there) != 1:
        problem = "both units" if there else ("no unit" if name in columns else "no such column")
        raise ValueError(f"{path}: {name}: {problem}, expected the column {name}_deg or {name}_rad.")
    values, unit = columns[f"{name}_{there[0]}"], RADIANS_PER_UNIT[there[0]]
    high = math.pi / 2 if name.startswith("theta") else 2 * math.tau
    bad = ~(np.abs(values * unit) <= high + 1e-6)
    if bad.any():
        row = int(bad.argmax())
        raise ValueError(
            f"{path}: line {lines[row]}: {name} {values[row]:.6g} {there[0]}, expected {-high / unit:.6g} to "
            f"{high / unit:.6g}; reflection alone can be fitted."
        )
    result: Doubles = values * unit
    return result


def _colours(path: Path, names: Sequence[str]) -> tuple[list[str], Doubles]:
    """The columns of the BRDF, and the matrix from them to linear RGB, [C, 3]."""
    if all(name in names for name in RGB_COLUMNS):
        return list(RGB_COLUMNS), np.eye(3)
    spectral = {float(found[1]): name for name in names if (found := _WAVELENGTH.fullmatch(name))}
    if not spectral:
        missing = next(name for name in RGB_COLUMNS if name not in names)
        raise ValueError(f"{path}: no column {missing}, expected r, g, b, or wavelengths such as 400nm, 410nm, ...")
    nanometres = np.array(sorted(spectral))
    if len(nanometres) < 4 or nanometres[0] > VISIBLE_RANGE_NM[0] or nanometres[-1] < VISIBLE_RANGE_NM[1]:
        raise ValueError(
            f"{path}: {len(nanometres)} wavelengths from {nanometres[0]:g} to {nanometres[-1]:g} nm, expected 4 or "
            f"more that cover {VISIBLE_RANGE_NM[0]:g} to {VISIBLE_RANGE_NM[1]:g} nm."
        )
    return [spectral[wavelength] for wavelength in nanometres], spectrum_to_rgb_matrix(nanometres)


def _direction(theta: Doubles, phi: Doubles) -> Doubles:
    """Unit vectors [N, 3] of spherical angles in rad; of a negative theta at phi + pi."""
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
