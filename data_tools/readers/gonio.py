"""Gonioreflectometer measurements as CSV: one pair of directions a row, with its BRDF.

A line of column names, then numbers; lines that begin with # are comments. `theta_i, phi_i` is the light, `theta_o,
phi_o` the detector, with the unit behind: `theta_i_deg` or `theta_i_rad`; thetas from the normal. The BRDF in 1/sr is
`r, g, b`, linear RGB, or columns of wavelengths, `400nm, 410nm, ...`, which become linear RGB of the material in D65.
Columns stand in any order; others are passed over.
"""

from __future__ import annotations

import functools
import itertools
import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_tools.readers import brdf_task
from data_tools.readers.colours import spectra_to_rgb
from data_tools.readers.listing import find_by_suffix, has_suffix
from metapp.appearance.geometry import directions_to_four_angles
from metapp.appearance.sphere import reference_scene, shade_sphere
from metapp.learning.task import Task
from metapp.storage.files import write_atomically

if TYPE_CHECKING:
    from scipy.spatial import KDTree

Array = NDArray[np.float64]

SUFFIX = ".csv"
ANGLES = ("theta_i", "phi_i", "theta_o", "phi_o")
UNITS = {key: unit for key, unit in brdf_task.UNITS.items() if key != "environment"}
RADIANS = {"deg": math.pi / 180, "rad": 1.0}
RGB = ("r", "g", "b")
LEAST = 4  # pairs of directions
FEW = 1000  # up to so many none is held out, and a recipe of its own fits them
LARGEST = 1e9  # of a BRDF, in 1/sr
LAST_RAD = math.radians(89.999)  # from the normal: what is nearer to the surface is left out
VISIBLE = (420.0, 680.0)  # nm, that spectra must cover
NEIGHBOURS = 6  # measurements that a pixel of the picture is made of
COMPARED, PAIRED = 20_000, 8  # measurements that tell whether phi_h counts, and neighbours of each
EXPLAINED = 0.1  # share of the squared differences of neighbours, from which on phi_h counts
TOLD = 64  # measurements that tell so at least
STEEPEST_RAD = math.radians(3)  # half vectors nearer to the normal have no azimuth to speak of
LONGEST = 1 << 28  # bytes of a file

_WAVELENGTH = re.compile(r"(\d{3,4}(?:\.\d+)?)\s*nm")

find = functools.partial(find_by_suffix, suffix=SUFFIX, what="a .csv file of a goniometer")
recognises = functools.partial(has_suffix, suffix=SUFFIX)


def has_few(path: Path) -> bool:
    """Whether a file, or each in a folder, has FEW rows at most."""
    files, _ = find([path])
    return all(_few_lines(file) for file in files)


def has_few_task(task: Task) -> bool:
    """Whether a task is of FEW measurements at most."""
    return len(task.data["angles"]) <= 2 * FEW


def _few_lines(file: Path) -> bool:
    with file.open(encoding="utf-8-sig", errors="replace") as lines:
        rows = (line for line in lines if line.strip() and line.lstrip()[0] != "#")
        return sum(1 for _ in itertools.islice(rows, FEW + 2)) <= FEW + 1  # with the line of names


def read_task(path: Path) -> Task:
    """Turn measurements into a BRDF task, named by the file's stem.

    Nothing is resampled: the samples are the measurements, in random order, half of them for fits to see; where there
    are FEW at most, fits see all of them, and errors are of what fits saw. Those of the same half and difference
    angles, to 1e-5 rad, are averaged, since a held-out sample must not have been seen; those along the surface are
    left out. Only the picture interpolates, and there is none under an environment map.

    Returns:
        angles [N, 3] rad, reflectance [N, 3] in 1/sr, linear RGB, and render [96, 96, 4], float32; phi_h [N] where that
        counts, as `depends_on_azimuth` says.

    Raises:
        ValueError: as `read_pairs`; too few measurements.
    """
    return _task(path.stem, path, *read_pairs(path))


def is_anisotropic(path: Path) -> bool:
    """Whether a table, or one of a folder, is of an anisotropic material; of bad ones nothing is said."""
    files = sorted(path.rglob(f"*{SUFFIX}")) if path.is_dir() else [path]
    for file in files:
        try:
            light, viewer, reflectance = read_pairs(file)
        except (ValueError, OSError):
            continue
        if depends_on_azimuth(directions_to_four_angles(light, viewer), reflectance):
            return True
    return False


def task_of_directions(name: str, wi: Tensor, wo: Tensor, reflectance: Tensor) -> Task:
    """The same of measurements in memory.

    Args:
        name: of the task.
        wi, wo: unit vectors [N, 3] to light and detector, z the normal, float64; rows along or below the surface are
            left out.
        reflectance: linear RGB [N, 3] in 1/sr, float64.

    Raises:
        ValueError: too few measurements; arrays of different lengths.
    """
    if not len(wi) == len(wo) == len(reflectance):
        raise ValueError(f"{name}: {len(wi)}, {len(wo)} and {len(reflectance)} rows, expected as many of each.")
    above = torch.minimum(wi[:, 2], wo[:, 2]) > math.cos(LAST_RAD)
    return _task(name, name, wi[above], wo[above], reflectance[above])


def _task(name: str, source: str | Path, light: Tensor, viewer: Tensor, reflectance: Tensor) -> Task:
    from scipy.spatial import KDTree  # here: every BRDF file is first shown to this reader, whatever it is

    angles = directions_to_four_angles(light, viewer)
    azimuths = depends_on_azimuth(angles, reflectance)
    angles, reflectance = _distinct(angles if azimuths else angles[:, :3], reflectance)
    if len(angles) < LEAST:
        raise ValueError(f"{source}: {len(angles)} pairs of directions, expected {LEAST} or more; measure more.")
    order = torch.randperm(len(angles), generator=torch.Generator().manual_seed(0))
    near = functools.partial(_near, KDTree(_points(angles)), reflectance)
    render = shade_sphere(reference_scene(azimuths=azimuths), near).float()
    if len(order) <= FEW:
        order = order.repeat(2)
    samples = brdf_task.columns_of(angles[order].float())
    return Task(name, {**samples, "reflectance": reflectance[order].float(), "render": render})


def depends_on_azimuth(angles: Tensor, reflectance: Tensor) -> bool:
    """Whether reflectance depends on phi_h: whether that explains how neighbours in the other angles differ.

    By least squares of differences of log reflectance on differences of the first two harmonics of phi_h, which noise
    does not follow. Of measurements at one azimuth nothing is told: they count as isotropic.

    Args:
        angles: [N, 4] in rad.
        reflectance: [N, 3] in 1/sr.
    """
    from scipy.spatial import KDTree

    tilted = angles[:, 0] > STEEPEST_RAD
    angles, values = angles[tilted], torch.log(reflectance[tilted].mean(1) + 1e-3)
    if len(angles) < TOLD:
        return False
    order = torch.randperm(len(angles), generator=torch.Generator().manual_seed(0))[:COMPARED]
    points = _points(angles[:, :3])
    near = KDTree(points).query(points[order.numpy()], k=1 + PAIRED)[1][:, 1:]
    first, second = order[:, None].expand(-1, PAIRED).reshape(-1), torch.from_numpy(near).reshape(-1)
    phi_h = angles[:, 3]
    waves = torch.stack([phi_h.cos(), phi_h.sin(), (2 * phi_h).cos(), (2 * phi_h).sin()], 1).double()
    changes, difference = waves[first] - waves[second], (values[first] - values[second]).double()
    total = float(difference.square().sum())
    gram = changes.T @ changes + 1e-9 * len(changes) * torch.eye(4, dtype=torch.float64)
    moment = changes.T @ difference
    # a few numbers explain a share of noise, too
    explained = float(moment @ torch.linalg.solve(gram, moment)) - 4 * total / len(order)
    return total > 0 and explained > EXPLAINED * total


class _Rows(NamedTuple):
    """The numbers of a file.

    Attributes:
        names: of the columns.
        numbers: [N, C].
        lines: in the file, [N].
    """

    names: list[str]
    numbers: Array
    lines: list[int]

    def column(self, name: str) -> Array:
        """The numbers of a column [N]."""
        values: Array = self.numbers[:, self.names.index(name)]
        return values


class Pairs(NamedTuple):
    """Measured pairs of directions.

    Attributes:
        wi, wo: unit vectors [N, 3] to light and detector, above the surface, z the normal, float64.
        reflectance: linear RGB [N, 3] in 1/sr, >= 0, float64.
    """

    wi: Tensor
    wo: Tensor
    reflectance: Tensor


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
    rows = _rows(path)
    angles = np.stack([_angle(path, rows, name) for name in ANGLES], 1)
    names, matrix = _colours(path, rows.names)
    values = np.stack([rows.column(name) for name in names], 1)
    bad = ~((values >= 0) & (values <= LARGEST))
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise ValueError(
            f"{path}: line {rows.lines[row]}: {names[column]} {values[row, column]:.6g}, expected 0 to "
            f"{LARGEST:g} in 1/sr; fill in what a plan asks for, and leave out rows that were not measured."
        )
    above = (angles[:, [0, 2]] < LAST_RAD).all(1)
    light, viewer = (torch.from_numpy(_direction(angles[above, i], angles[above, i + 1])) for i in (0, 2))
    return Pairs(light, viewer, torch.from_numpy((values @ matrix)[above]).clamp_min(0))


def write_pairs(path: Path, wi: Tensor, wo: Tensor, before: Pairs) -> None:
    """Write a table to fill in: what was measured before, then pairs of unit vectors [N, 3] without a BRDF."""
    lines = [
        "# the BRDF in 1/sr as linear RGB, a row a pair of directions: theta_i, phi_i light, theta_o, phi_o detector"
    ]
    lines += ["# fill in all rows; leave out those that cannot be measured"] * (len(wi) > 0)
    lines += [",".join([*(f"{name}_deg" for name in ANGLES), *RGB])]
    for *pair, colour in zip(before.wi, before.wo, before.reflectance.tolist(), strict=True):
        lines.append(",".join([*_degrees(*pair), *(f"{value:.6g}" for value in colour)]))
    lines += [",".join([*_degrees(*pair), "", "", ""]) for pair in zip(wi, wo, strict=True)]
    write_atomically(path, lambda file: file.write_text("\n".join(lines) + "\n", encoding="utf-8"))


def _degrees(*vectors: Tensor) -> Iterator[str]:
    for x, y, z in (vector.tolist() for vector in vectors):
        yield from (f"{math.degrees(angle):.2f}" for angle in (math.atan2(math.hypot(x, y), z), math.atan2(y, x)))


def _rows(path: Path) -> _Rows:
    """All rows of a file that are no comments."""
    if path.stat().st_size > LONGEST:
        raise ValueError(f"{path}: {path.stat().st_size:,} bytes, expected at most {LONGEST:,}; take fewer rows.")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{path}: no text in UTF-8, expected a table of numbers as CSV; save it as CSV.") from None
    lines = [(at, line) for at, line in enumerate(text.split("\n"), 1) if line.strip() and line.lstrip()[0] != "#"]
    if not lines:
        raise ValueError(f"{path}: no rows, expected a line of column names and rows of numbers.")
    names = [name.strip().lower() for name in lines[0][1].split(",")]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{path}: two columns {_shown(twice)}, expected names that differ; rename one.")
    cells = [_cells(path, at, line, len(names)) for at, line in lines[1:]]
    return _Rows(names, np.array(cells).reshape(len(cells), len(names)), [at for at, _ in lines[1:]])


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


def _angle(path: Path, rows: _Rows, name: str) -> Array:
    """One of the angles in rad, [N], thetas in [0, pi/2]."""
    there = [unit for unit in RADIANS if f"{name}_{unit}" in rows.names]
    if len(there) != 1:
        found = "both units" if there else ("no unit" if name in rows.names else "no such column")
        raise ValueError(f"{path}: {name}: {found}, expected the column {name}_deg or {name}_rad.")
    values, unit = rows.column(f"{name}_{there[0]}"), RADIANS[there[0]]
    low, high = (0.0, math.pi / 2) if name.startswith("theta") else (-2 * math.tau, 2 * math.tau)
    bad = ~((values * unit >= low - 1e-6) & (values * unit <= high + 1e-6))
    if bad.any():
        row = int(bad.argmax())
        raise ValueError(
            f"{path}: line {rows.lines[row]}: {name} {values[row]:.6g} {there[0]}, expected {low / unit:.6g} to "
            f"{high / unit:.6g}; reflection alone can be fitted."
        )
    result: Array = values * unit
    return result


def _colours(path: Path, names: Sequence[str]) -> tuple[list[str], Array]:
    """The columns of the BRDF, and what makes linear RGB of them, [C, 3]."""
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


def _distinct(angles: Tensor, reflectance: Tensor) -> tuple[Tensor, Tensor]:
    """The same with one mean value where several are of the same angles."""
    _, inverse, count = torch.unique((angles * 1e5).round(), dim=0, return_inverse=True, return_counts=True)

    def mean(values: Tensor) -> Tensor:
        total = torch.zeros(len(count), values.shape[1], dtype=values.dtype).index_add(0, inverse, values)
        result: Tensor = total / count[:, None]
        return result

    return mean(angles), mean(reflectance)


def _points(angles: Tensor) -> Array:
    """Angles [N, 3 or 4] as points [N, 4 or 5] whose distances say how alike they are: highlights are narrow."""
    theta_h, theta_d, phi_d = angles[:, :3].double().unbind(-1)
    turn = 2 * phi_d  # by reciprocity phi_d + pi is phi_d
    radius = 2 * theta_h.sqrt()
    half = [radius] if angles.shape[1] == 3 else [radius * angles[:, 3].cos(), radius * angles[:, 3].sin()]
    return torch.stack([*half, theta_d, theta_d * turn.cos() / 2, theta_d * turn.sin() / 2], -1).numpy()


def _near(tree: KDTree, reflectance: Tensor, angles: Tensor) -> Tensor:
    """Reflectance [M, 3] beside measurements: the mean of log(1 + f) of the nearest, by inverse distance."""
    distance, index = tree.query(_points(angles), k=NEIGHBOURS)
    weights = torch.from_numpy(1 / (distance + 1e-3))[..., None]
    total: Tensor = (reflectance.log1p()[index] * weights).sum(1)
    result: Tensor = torch.expm1(total / weights.sum(1)).to(angles.dtype)
    return result
