"""Gonioreflectometer measurements as CSV: a row for each pair of directions, with its BRDF.

A file holds a line of column names, perhaps one of units, then numbers; lines that begin with # are comments.
`theta_i, phi_i` is the light, `theta_o, phi_o` the detector, with the unit behind, `theta_i_deg` or `theta_i_rad`, or
below; thetas are from the normal, negative ones at phi + 180 degrees. A file may hold other angles in place of these,
such as elevations or the azimuth between both directions, see `gonio_angles`; `angle_conventions` doubts angles that
are not what their columns say. The BRDF in 1/sr is `r, g, b`, linear RGB, or columns of wavelengths, `400nm, 410nm,
...`, which become linear RGB of the material in D65. Columns may be in any order; unknown ones are ignored. Text is
UTF-8 or UTF-16; cells are separated by commas, semicolons, tabs or bars, as Excel's line `sep=;` or the column names
tell; cells may be in quotes, and decimal commas are read beside another separator or in quotes.
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
from torch import Tensor

from data_tools.readers import brdf_task
from data_tools.readers.angle_conventions import warn_of_angles
from data_tools.readers.gonio_angles import ANGLE_COLUMNS, AngleTable, SphericalAngles, name_angle, read_directions
from data_tools.readers.input_source import ANISOTROPIC_FACT, DAMAGED_FACT, SAMPLE_COUNT_FACT, Source, Sources
from data_tools.readers.listing import find_by_suffix, has_suffix
from data_tools.readers.measured_pairs import MeasuredPairs, find_bad_reflectance, merge_repeats, task_of_pairs
from data_tools.readers.numbers import Doubles
from data_tools.readers.reciprocity import require_reciprocity
from metapp.appearance.colorimetry import spectrum_to_rgb_matrix
from metapp.learning.task import Task
from metapp.storage.files import open_text, write_bytes

GONIO_SUFFIX = ".csv"
UNITS = {key: unit for key, unit in brdf_task.UNITS.items() if key != "environment"}
RGB_COLUMNS = ("r", "g", "b")
VISIBLE_RANGE_NM = (420.0, 680.0)  # spectra must cover it
MAX_KEPT_TABLE_BYTES = 1 << 26
MAX_TABLE_BYTES = 1 << 28  # of a file

_MAX_LINE_CHARACTERS = 1 << 20  # of a line
_SEPARATORS = ",;\t|"
_UNIT_ENDINGS = {"deg": "_deg", "degree": "_deg", "degrees": "_deg", "°": "_deg", "rad": "_rad", "radian": "_rad",
          "radians": "_rad", "nm": "nm"}  # fmt: skip
_WAVELENGTH = re.compile(r"(\d{3,4}(?:\.\d+)?)\s*nm")

recognises = functools.partial(has_suffix, suffix=GONIO_SUFFIX)


def find(path: Path, *, max_kept_bytes: int = MAX_KEPT_TABLE_BYTES) -> Sources:
    """Find tables and parse them, since whether a material is anisotropic follows from its measurements.

    A table that cannot be read is marked as damaged; reading it later says what is wrong.

    Args:
        path: a file, or a folder of files.
        max_kept_bytes: the size of the parsed tables that the sources keep; further ones are parsed again when read.
    """
    files, skipped = find_by_suffix(path, GONIO_SUFFIX, "a .csv file of a goniometer")
    sources, kept_bytes = [], 0
    for file in files:
        try:
            pairs = read_pairs(file)
        except (ValueError, OSError):
            sources.append(Source(file.stem, file, facts={DAMAGED_FACT: True}))
            continue
        angles, _ = merge_repeats(pairs)
        facts = {ANISOTROPIC_FACT: angles.shape[1] == 4, SAMPLE_COUNT_FACT: len(angles)}
        kept_bytes += sum(values.nbytes for values in pairs)
        sources.append(Source(file.stem, file, facts=facts, content=pairs if kept_bytes <= max_kept_bytes else None))
    return sources, skipped


def read_task(path: Path, content: MeasuredPairs | None = None) -> Task:
    """Read measurements as a BRDF task named by the file's stem; see :func:`task_of_pairs`.

    Args:
        path: the file.
        content: its measurements, as :func:`find` has parsed them; None to read the file.

    Raises:
        ValueError: the file cannot be read (see :func:`read_pairs`); there are too few measurements.
    """
    return task_of_pairs(path.stem, content or read_pairs(path), path)


def read_pairs(path: Path) -> MeasuredPairs:
    """Read the measurements of a file; rows along or below the surface are left out.

    Raises:
        ValueError: the file is no such table: missing columns, rows that are no numbers, negative or huge values,
            angles beyond their range.
    """
    table = _read_columns(path)
    angles = read_directions(path, table)
    names, matrix = _find_colours(path, list(table.columns))
    values = np.stack([table.columns[name] for name in names], 1)
    if bad_value := find_bad_reflectance(path, values):
        row, column, expected = bad_value
        subject = f"{path}: line {table.lines[row]}: {table.titles[names[column]]}"
        raise ValueError(f"{subject} {values[row, column]:.6g}, expected {expected}.")
    if not values.any():
        warnings.warn(f"{path}: reflectance 0 everywhere, expected some light reflected; is it damaged?", stacklevel=2)
    reflectance = torch.from_numpy(values @ matrix).clamp_min(0)
    light, detector = angles.directions() if isinstance(angles, SphericalAngles) else angles
    pairs = MeasuredPairs(light, detector, reflectance).above(path)
    if not (isinstance(angles, SphericalAngles) and warn_of_angles(path, angles, reflectance)):
        require_reciprocity(path, pairs)  # by wrong angles a BRDF can look as if it held a cosine
    return pairs


def write_pairs(path: Path, wi: Tensor, wo: Tensor, before: MeasuredPairs) -> None:
    """Write a table for the user to fill in: earlier measurements, then pairs of directions without a BRDF.

    Args:
        path: the file to write.
        wi: unit vectors to the light, [N, 3], of pairs to measure.
        wo: unit vectors to the detector, [N, 3].
        before: the earlier measurements.
    """
    lines = [
        "# the BRDF in 1/sr as linear RGB, a row a pair of directions: theta_i, phi_i light, theta_o, phi_o detector"
    ]
    lines += ["# fill in all rows; leave out those that cannot be measured"] * (len(wi) > 0)
    lines += [",".join([*(f"{name}_deg" for name in ANGLE_COLUMNS), *RGB_COLUMNS])]
    for *pair, colour in zip(before.wi, before.wo, before.reflectance.tolist(), strict=True):
        lines.append(",".join([*_format_degrees(*pair), *(f"{value:.6g}" for value in colour)]))
    lines += [",".join([*_format_degrees(*pair), "", "", ""]) for pair in zip(wi, wo, strict=True)]
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def _format_degrees(*vectors: Tensor) -> Iterator[str]:
    """Yield theta and phi in degrees, as text, of vectors [3]."""
    for x, y, z in (vector.tolist() for vector in vectors):
        yield from (f"{math.degrees(angle):.2f}" for angle in (math.atan2(math.hypot(x, y), z), math.atan2(y, x)))


def _read_columns(path: Path) -> AngleTable:
    """Read the columns of a file, without its comments.

    Raises:
        ValueError: the file is too large, is not text, or holds no table of numbers.
    """
    size = path.stat().st_size
    if size > MAX_TABLE_BYTES:
        raise ValueError(
            f"{path}: {size:,} bytes, expected at most {MAX_TABLE_BYTES:,}, some 6 million rows; keep one row in "
            f"{math.ceil(size / MAX_TABLE_BYTES)}."
        )
    try:
        with open_text(path) as text:
            rows = list(_read_lines(path, text))
    except UnicodeDecodeError:
        remedy = "save it as CSV in UTF-8"
        raise ValueError(f"{path}: no text in UTF-8 or UTF-16, expected a table of numbers; {remedy}.") from None
    separator_line = re.fullmatch(r'"?sep=(.)"?', rows[0][1].rstrip("\r\n"), re.IGNORECASE) if rows else None
    rows = rows[1:] if separator_line else rows
    if not rows:
        raise ValueError(f"{path}: no rows, expected a line of column names and rows of numbers; add them.")
    separator = separator_line[1] if separator_line else max(_SEPARATORS, key=rows[0][1].count)
    titles = _split_cells(rows.pop(0)[1], separator)
    cells_below = _split_cells(rows[0][1].lower(), separator) if rows else []
    units = [cell.strip("[]() ") for cell in cells_below] if not any(map(_is_number, cells_below)) else []
    rows = rows[1:] if units else rows
    names = [
        _name_column(*name_and_unit)
        for name_and_unit in itertools.zip_longest(titles, units[: len(titles)], fillvalue="")
    ]
    if len(set(names)) < len(names):
        repeated_name = next(name for name in names if names.count(name) > 1)
        if all(map(_is_number, filter(None, names))):
            found = f"the first line holds numbers, such as {_quote(repeated_name)}"
            raise ValueError(f"{path}: {found}, expected column names: theta_i_deg, phi_i_deg, ..., r, g, b; add them.")
        raise ValueError(f"{path}: two columns {_quote(repeated_name)}, expected names that differ; rename one.")
    if not rows:
        raise ValueError(f"{path}: no rows below the column names, expected a row for each measurement; add them.")
    number_lines = (line if separator == "," else line.replace(",", ".") for _, line in rows)
    numbers = np.empty((0, 0))
    with contextlib.suppress(ValueError):  # ten times as fast as cell by cell, but does not say which line is wrong
        numbers = np.loadtxt(number_lines, delimiter=separator, ndmin=2, quotechar='"')
    if numbers.shape != (len(rows), len(names)):
        cells = [
            _parse_cells(path, line_number, _split_cells(line, separator), len(names)) for line_number, line in rows
        ]
        numbers = np.array(cells, np.float64).reshape(-1, len(names))
    columns = dict(zip(names, numbers.T, strict=True))
    return AngleTable(columns, dict(zip(names, titles, strict=True)), [line_number for line_number, _ in rows])


def _read_lines(path: Path, text: io.TextIOWrapper) -> Iterator[tuple[int, str]]:
    """Yield the lines with something in a cell, each with its number; comments are left out.

    Raises:
        ValueError: a line is too long.
    """
    for line_number in itertools.count(1):
        line = text.readline(_MAX_LINE_CHARACTERS + 1)
        if len(line) > _MAX_LINE_CHARACTERS:
            found = f"line {line_number}: more than {_MAX_LINE_CHARACTERS:,} characters"
            raise ValueError(f"{path}: {found}, expected a row for each pair of directions; break the line.")
        if not line:
            return
        if line.strip(_SEPARATORS + '" \r\n') and line.lstrip()[0] != "#":
            yield line_number, line


def _split_cells(line: str, separator: str) -> list[str]:
    """Split a line into its cells; a line that csv cannot split is one cell."""
    with contextlib.suppress(csv.Error):  # csv refuses a cell of more characters than any number has
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
    return [line]


def _name_column(name: str, unit: str) -> str:
    """Return a column's name with its unit behind; in the file, the unit stands in brackets or in the line below."""
    name, _, bracketed = name.replace("(", "[").partition("[")
    ending = _UNIT_ENDINGS.get(bracketed.lower().strip("]) ") or unit, "")
    name = (angle := name_angle(name.strip())) or name.strip().lower()
    return name if name.endswith(ending) or not (angle or ending == "nm") else f"{name}{ending}"


def _is_number(word: str) -> bool:
    """Tell whether a cell is a number, with a decimal point or comma."""
    with contextlib.suppress(ValueError):
        float(word.replace(",", "."))
        return True
    return False


def _parse_cells(path: Path, line_number: int, cells: list[str], count: int) -> list[float]:
    """Return the numbers of a row, nan for an empty cell.

    Raises:
        ValueError: the row has another number of cells than `count`, or one that is no number.
    """
    if len(cells) != count:
        raise ValueError(
            f"{path}: line {line_number}: {len(cells)} numbers, expected {count}, one for each column name; "
            "add or remove cells."
        )
    if bad_cells := [cell for cell in cells if cell and not _is_number(cell)]:
        raise ValueError(f"{path}: line {line_number}: {_quote(bad_cells[0])}, expected a number; correct the cell.")
    return [float(cell.replace(",", ".")) if cell else math.nan for cell in cells]


def _quote(word: str) -> str:
    """Return a word of a file in quotes, short and printable."""
    return repr(word.strip()[:30])


def _find_colours(path: Path, names: Sequence[str]) -> tuple[list[str], Doubles]:
    """Return the names of the BRDF's C columns, and the matrix [C, 3] from their values to linear RGB.

    Raises:
        ValueError: colours are missing, or wavelengths are too few or do not cover VISIBLE_RANGE_NM.
    """
    if all(name in names for name in RGB_COLUMNS):
        return list(RGB_COLUMNS), np.eye(3)
    spectral = {float(match[1]): name for name in names if (match := _WAVELENGTH.fullmatch(name))}
    if not spectral:
        missing = next(name for name in RGB_COLUMNS if name not in names)
        raise ValueError(
            f"{path}: no column {missing}, expected r, g, b, or wavelengths such as 400nm, 410nm; add them."
        )
    wavelengths_nm = np.array(sorted(spectral))
    if len(wavelengths_nm) < 4 or wavelengths_nm[0] > VISIBLE_RANGE_NM[0] or wavelengths_nm[-1] < VISIBLE_RANGE_NM[1]:
        found = f"{len(wavelengths_nm)} wavelengths from {wavelengths_nm[0]:g} to {wavelengths_nm[-1]:g} nm"
        raise ValueError(
            f"{path}: {found}, expected 4 or more that cover {VISIBLE_RANGE_NM[0]:g} to {VISIBLE_RANGE_NM[1]:g} nm; "
            "add columns for them."
        )
    return [spectral[wavelength] for wavelength in wavelengths_nm], spectrum_to_rgb_matrix(wavelengths_nm)
