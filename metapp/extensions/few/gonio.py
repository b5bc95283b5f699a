"""Gonioreflectometer measurements as CSV: one pair of directions a row, with its BRDF.

A line of column names, then numbers; lines that begin with # are comments. `theta_i, phi_i` is the light, `theta_o,
phi_o` the detector, with the unit behind: `theta_i_deg` or `theta_i_rad`; thetas from the normal. The BRDF in 1/sr is
`r, g, b`, linear RGB, or columns of wavelengths, `400nm, 410nm, ...`, which become linear RGB of the material in D65.
Columns stand in any order; others are passed over.
"""

from __future__ import annotations

import contextlib
import functools
import io
import itertools
import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_tools.readers import brdf_task
from data_tools.readers.listing import any_passes, find_by_suffix, has_suffix
from data_tools.readers.measured_pairs import FEW, LARGEST, Pairs, depends_on_azimuth, task_of_pairs
from metapp.appearance.colorimetry import spectra_to_rgb
from metapp.appearance.geometry import directions_to_four_angles
from metapp.learning.task import Task
from metapp.storage.files import open_regular, write_bytes

Array = NDArray[np.float64]

SUFFIX = ".csv"
ANGLES = ("theta_i", "phi_i", "theta_o", "phi_o")
UNITS = {key: unit for key, unit in brdf_task.UNITS.items() if key != "environment"}
RADIANS = {"deg": math.pi / 180, "rad": 1.0}
RGB = ("r", "g", "b")
VISIBLE = (420.0, 680.0)  # nm, that spectra must cover
LONGEST = 1 << 28  # bytes of a file

_WAVELENGTH = re.compile(r"(\d{3,4}(?:\.\d+)?)\s*nm")

find = functools.partial(find_by_suffix, suffix=SUFFIX, what="a .csv file of a goniometer")
recognises = functools.partial(has_suffix, suffix=SUFFIX)


def has_few(path: Path) -> bool:
    """Test whether a file, or each in a folder, has FEW rows at most."""
    return all(_few_lines(file) for file in find(path)[0])


def has_few_task(task: Task) -> bool:
    """Test whether a task is of FEW measurements at most, of which none is held out."""
    first, second = task.data["angles"].chunk(2)
    return torch.equal(first, second)


def _few_lines(file: Path) -> bool:
    with io.TextIOWrapper(open_regular(file), "utf-8-sig", "replace") as lines:
        rows = (line for line in lines if line.strip() and line.lstrip()[0] != "#")
        return sum(1 for _ in itertools.islice(rows, FEW + 2)) <= FEW + 1  # with the line of names


def read_task(path: Path) -> Task:
    """Turn measurements into a BRDF task, named by the file's stem, as `task_of_pairs` says.

    Raises:
        ValueError: as `read_pairs`; too few measurements.
    """
    return task_of_pairs(path.stem, read_pairs(path), path)


def is_anisotropic(path: Path) -> bool:
    """Test whether a table, or one of a folder, is of an anisotropic material; of bad ones nothing is said."""

    def turns(file: Path) -> bool:
        pairs = read_pairs(file)
        return depends_on_azimuth(directions_to_four_angles(pairs.wi, pairs.wo), pairs.reflectance)

    return any_passes(path, SUFFIX, turns)


def read_pairs(path: Path) -> Pairs:
    """Read a file; rows along or below the surface are left out.

    Raises:
        ValueError: no such table: missing columns, rows that are no numbers, negative or huge values, angles beyond
            their range.
    """
    state = path.stat()
    return _parsed(path, state.st_size, state.st_mtime_ns)


@functools.lru_cache(maxsize=2)  # what chooses a recipe has read the file that is then fitted
def _parsed(path: Path, size: int, changed_ns: int) -> Pairs:
    columns, lines = _rows(path)
    angles = np.stack([_angle(path, columns, lines, name) for name in ANGLES], 1)
    names, matrix = _colours(path, list(columns))
    values = np.stack([columns[name] for name in names], 1)
    bad = ~((values >= 0) & (values <= LARGEST))
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise ValueError(
            f"{path}: line {lines[row]}: {names[column]} {values[row, column]:.6g}, expected 0 to "
            f"{LARGEST:g} in 1/sr; fill in what a plan asks for, and leave out rows that were not measured."
        )
    light, viewer = (torch.from_numpy(_direction(angles[:, i], angles[:, i + 1])) for i in (0, 2))
    return Pairs(light, viewer, torch.from_numpy(values @ matrix).clamp_min(0)).above()


def write_pairs(path: Path, wi: Tensor, wo: Tensor, before: Pairs) -> None:
    """Write a table to fill in: earlier measurements, then pairs of unit vectors [N, 3] without a BRDF."""
    lines = [
        "# the BRDF in 1/sr as linear RGB, a row a pair of directions: theta_i, phi_i light, theta_o, phi_o detector"
    ]
    lines += ["# fill in all rows; leave out those that cannot be measured"] * (len(wi) > 0)
    lines += [",".join([*(f"{name}_deg" for name in ANGLES), *RGB])]
    for *pair, colour in zip(before.wi, before.wo, before.reflectance.tolist(), strict=True):
        lines.append(",".join([*_degrees(*pair), *(f"{value:.6g}" for value in colour)]))
    lines += [",".join([*_degrees(*pair), "", "", ""]) for pair in zip(wi, wo, strict=True)]
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def _degrees(*vectors: Tensor) -> Iterator[str]:
    for x, y, z in (vector.tolist() for vector in vectors):
        yield from (f"{math.degrees(angle):.2f}" for angle in (math.atan2(math.hypot(x, y), z), math.atan2(y, x)))


def _rows(path: Path) -> tuple[dict[str, Array], list[int]]:
    """The columns of a file by name, [N] each, and the line of each row; comments are left out."""
    size = path.stat().st_size
    if size > LONGEST:
        raise ValueError(
            f"{path}: {size:,} bytes, expected at most {LONGEST:,}, some 6 million rows; keep one row in "
            f"{math.ceil(size / LONGEST)}."
        )
    try:
        with io.TextIOWrapper(open_regular(path), "utf-8-sig") as file:
            rows = [(at, line) for at, line in enumerate(file, 1) if line.strip() and line.lstrip()[0] != "#"]
    except UnicodeDecodeError:
        raise ValueError(f"{path}: no text in UTF-8, expected a table of numbers as CSV; save it as CSV.") from None
    if not rows:
        raise ValueError(f"{path}: no rows, expected a line of column names and rows of numbers.")
    names = [name.strip().lower() for name in rows.pop(0)[1].split(",")]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{path}: two columns {_shown(twice)}, expected names that differ; rename one.")
    numbers = np.empty((0, 0))
    with contextlib.suppress(ValueError):  # ten times as fast, but of what is wrong it does not say the line
        numbers = np.loadtxt((line for _, line in rows), delimiter=",", ndmin=2)
    if numbers.shape != (len(rows), len(names)):
        cells = [_cells(path, at, line, len(names)) for at, line in rows]
        numbers = np.array(cells, np.float64).reshape(-1, len(names))
    return dict(zip(names, numbers.T, strict=True)), [at for at, _ in rows]


def _cells(path: Path, at: int, line: str, count: int) -> list[float]:
    words = line.split(",")
    if len(words) != count:
        raise ValueError(f"{path}: line {at}: {len(words)} numbers, expected {count} as column names; put it right.")
    cells = []
    for word in words:
        try:
            cells.append(float(word) if word.strip() else math.nan)
        except ValueError:
            raise ValueError(f"{path}: line {at}: {_shown(word)}, expected a number; put it right.") from None
    return cells


def _shown(word: str) -> str:
    """A word of a file, short and printable, in quotes."""
    return repr(word.strip()[:30])


def _angle(path: Path, columns: dict[str, Array], lines: list[int], name: str) -> Array:
    """One of the angles in rad, [N], thetas in [0, pi/2]."""
    there = [unit for unit in RADIANS if f"{name}_{unit}" in columns]
    if len(there) != 1:
        problem = "both units" if there else ("no unit" if name in columns else "no such column")
        raise ValueError(f"{path}: {name}: {problem}, expected the column {name}_deg or {name}_rad.")
    values, unit = columns[f"{name}_{there[0]}"], RADIANS[there[0]]
    low, high = (0.0, math.pi / 2) if name.startswith("theta") else (-2 * math.tau, 2 * math.tau)
    bad = ~((values * unit >= low - 1e-6) & (values * unit <= high + 1e-6))
    if bad.any():
        row = int(bad.argmax())
        raise ValueError(
            f"{path}: line {lines[row]}: {name} {values[row]:.6g} {there[0]}, expected {low / unit:.6g} to "
            f"{high / unit:.6g}; reflection alone can be fitted."
        )
    result: Array = values * unit
    return result


def _colours(path: Path, names: Sequence[str]) -> tuple[list[str], Array]:
    """The columns of the BRDF, and the matrix from them to linear RGB, [C, 3]."""
    if all(name in names for name in RGB):
        return list(RGB), np.eye(3)
    spectral = {float(found[1]): name for name in names if (found := _WAVELENGTH.fullmatch(name))}
    if not spectral:
        missing = next(name for name in RGB if name not in names)
        raise ValueError(f"{path}: no column {missing}, expected r, g, b, or wavelengths such as 400nm, 410nm, ...")
    nanometres = np.array(sorted(spectral))
    if len(nanometres) < 4 or nanometres[0] > VISIBLE[0] or nanometres[-1] < VISIBLE[1]:
        raise ValueError(
            f"{path}: {len(nanometres)} wavelengths from {nanometres[0]:g} to {nanometres[-1]:g} nm, expected 4 or "
            f"more that cover {VISIBLE[0]:g} to {VISIBLE[1]:g} nm."
        )
    return [spectral[wavelength] for wavelength in nanometres], spectra_to_rgb(nanometres)


def _direction(theta: Array, phi: Array) -> Array:
    """Unit vectors [N, 3] of spherical angles in rad."""
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
