"""MERL BRDF tables: read, write, evaluate, tabulate.

A file holds 90 x 90 x 180 entries of an isotropic BRDF over (theta_h, theta_d, phi_d) rad, phi_h = 0: three int32
(90, 90, 180), then all red, all green, all blue values as float64, little-endian, phi_d fastest. In a file, values are
scaled by 1500, 1500/1.15, 1500/1.66; in a table here they are linear RGB reflectance in 1/sr. theta_h has square-root
spacing: bin i covers ((i/90)^2, ((i+1)/90)^2) * pi/2; theta_d covers 0..pi/2 and phi_d 0..pi evenly.

An entry is invalid if all its channels are negative (-1 in most files): nothing was measured, mostly since a direction
is below the horizon. A lone negative channel is noise: it stays in the table and evaluates to 0.

Source: Matusik et al. 2003, "A Data-Driven Reflectance Model", and the reader published with its data.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from data_tools.readers import brdf_task
from data_tools.readers.listing import files_of, find_files
from data_tools.readers.merl_table import SCALE, SHAPE, Array, merl_valid, tabulate
from metapp.learning.task import Params, Task
from metapp.storage.files import open_regular, suffixed, write_atomically

if TYPE_CHECKING:
    from metapp.apps.brdf.app import Brdf

UNITS = brdf_task.UNITS
SUFFIX = ".binary"
FILE_BYTES = 12 + 8 * 3 * math.prod(SHAPE)

_HEADER = np.array(SHAPE, dtype="<i4")
_MIN_VALID = 0.01  # three quarters of the bins are above the horizon
_ABOUT = f"{FILE_BYTES:,} (12-byte header + 3x90x90x180 doubles)"


def find(paths: Iterable[str | Path]) -> tuple[list[Path], list[str]]:
    """Find MERL files by size and header, as `find_files`; values are not looked at."""
    nothing = f"no MERL file, expected *.binary files of {_ABOUT}; name their folder."
    return find_files(paths, _check_file, _problem, nothing, (SUFFIX,))


def recognises(path: str | Path) -> bool:
    """True for a file named .binary or of a MERL file's size, and for a folder with one below it."""
    return any(file.suffix == SUFFIX or file.stat().st_size == FILE_BYTES for file in files_of(path))


def export(app: Brdf, theta: Params, path: Path) -> None:
    """Write a fitted network of the BRDF application as a MERL file; `path` without .binary gets it."""
    app.require_isotropic(path.name, "a MERL table")
    write_merl(suffixed(path, SUFFIX), tabulate(lambda angles: app.reflectance(theta, angles)))


def read_task(path: Path, samples: int = 65_536) -> Task:
    """A MERL file as a BRDF task, named by its stem; errors as of `read_merl`, warnings of implausible values."""
    return brdf_task.measured_task(path.stem, read_merl(path), samples, path)


def read_merl(path: str | Path) -> Array:
    """The table of a MERL file [90, 90, 180, 3]: linear RGB reflectance in 1/sr, invalid entries negative.

    It is a view of planes, as the file has them: interleaving the channels can take longer than reading them.

    Raises:
        ValueError: not a MERL file, an incomplete one, values that are not finite, almost no valid entries.
    """
    path = Path(path)
    _check_file(path)
    planes = np.fromfile(path, dtype="<f8", offset=12).astype(np.float64, copy=False).reshape(3, *SHAPE)
    _check_values(planes, str(path))
    planes *= SCALE[:, None, None, None]
    return np.moveaxis(planes, 0, -1)


def write_merl(path: str | Path, table: Array) -> None:
    """Write a table, as `read_merl` returns it, as a MERL file, whole or not at all; up to the last bit the same again.

    Raises:
        ValueError: another shape, values that are not finite, almost no valid entries.
    """
    if table.shape != (*SHAPE, 3):
        raise ValueError(f"{path}: table {table.shape}, expected {(*SHAPE, 3)} to write.")
    planes = np.stack([table[..., channel] / SCALE[channel] for channel in range(3)])
    _check_values(planes, str(path))

    def write(partial: Path) -> None:
        with partial.open("wb") as stream:
            stream.write(_HEADER.tobytes())
            planes.astype("<f8", copy=False).tofile(stream)

    write_atomically(path, write)


def _check_file(path: Path) -> None:
    """Refuse what is not a MERL file by its size and header."""
    if problem := _problem(path):
        raise ValueError(problem)


def _problem(path: Path) -> str:
    """The fault of a file's size or header; "" for none."""
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        return f"{path}: {found}, expected a MERL file; check the path."
    size = path.stat().st_size
    with open_regular(path) as stream:
        header = np.frombuffer(stream.read(12).ljust(12, b"\0"), dtype="<i4")
    matches = bool((header == _HEADER).all())
    if size != FILE_BYTES:
        remedy = "not a MERL file" if not matches else "the file has something appended, download it again"
        if matches and size < FILE_BYTES:
            remedy = "the download is probably incomplete"
        return f"{path}: {size:,} bytes, expected {_ABOUT}; {remedy}."
    found = "x".join(map(str, header.tolist()))
    return "" if matches else f"{path}: header {found}, expected 90x90x180; not a MERL file."


def _check_values(planes: Array, subject: str) -> None:
    """Refuse planes that no measurement gives."""
    # The sum is not finite if any value is not; it costs less than looking at each.
    with np.errstate(invalid="ignore", over="ignore"):
        total = planes.sum()
    if not np.isfinite(total) and not np.isfinite(planes).all():
        count = int((~np.isfinite(planes)).sum())
        raise ValueError(f"{subject}: {count:,} values are NaN or infinite, expected none; download or make it again.")
    valid = float(merl_valid(np.moveaxis(planes, 0, -1)).mean())
    if valid < _MIN_VALID:
        raise ValueError(
            f"{subject}: {valid:.2%} of the entries are valid (not negative), expected {_MIN_VALID:.0%} or more; "
            "not a measured BRDF."
        )
