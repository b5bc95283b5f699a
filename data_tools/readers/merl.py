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
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_tools.readers import brdf_task
from data_tools.readers.input_source import Sources, sources_of_files
from data_tools.readers.listing import files_of, find_files
from data_tools.readers.numbers import Doubles
from metapp.appearance.geometry import is_above_horizon
from metapp.learning.task import Task
from metapp.storage.files import add_suffix, open_regular, placeholder_line, write_atomically

if TYPE_CHECKING:
    from metapp.apps.brdf.reflectance import Reflectance

UNITS = brdf_task.UNITS
MERL_SUFFIX = ".binary"
TABLE_SHAPE = (90, 90, 180)  # bins of theta_h, theta_d and phi_d
CHANNEL_SCALES = np.array([1.0, 1.15, 1.66]) / 1500.0  # 1/sr for 1 in a file, of red, green and blue
MAX_FILE_VALUE = 1e30  # single precision, in which tables are interpolated, ends at 3e38
FILE_BYTES = 12 + 8 * 3 * math.prod(TABLE_SHAPE)

_HEADER = np.array(TABLE_SHAPE, dtype="<i4")
_MIN_VALID_SHARE = 0.01  # of all entries; three quarters of the bins are above the horizon
_EXPECTED_SIZE = f"{FILE_BYTES:,} (12-byte header + 3x90x90x180 doubles)"


def find(path: Path) -> Sources:
    """Find MERL files by size and header, without a look at their values; see :func:`find_files`."""
    nothing = f"no MERL file, expected *.binary files of {_EXPECTED_SIZE}; name their folder."
    return sources_of_files(find_files(path, _check_file, _find_fault, nothing, (MERL_SUFFIX,)))


def recognises(path: str | Path) -> bool:
    """Tell whether a path is a file named .binary or of a MERL file's size, or a folder with one at any depth."""
    return any(file.suffix.lower() == MERL_SUFFIX or file.stat().st_size == FILE_BYTES for file in files_of(path))


def export(asset: Reflectance, path: Path, provenance: Mapping[str, object]) -> None:
    """Write reflectance as a MERL file; .binary is added to a path without it."""
    asset.require_isotropic(path.name, "a MERL table")
    write_merl(add_suffix(path, MERL_SUFFIX), tabulate_merl(asset.evaluate))


def read_task(path: Path, samples: int = 65_536) -> Task:
    """Read a MERL file as a BRDF task named by the file's stem; warn if its values are implausible.

    Args:
        path: the file.
        samples: the number of samples.

    Raises:
        ValueError: the file cannot be read (see :func:`read_merl`), or has fewer bins than samples.
    """
    return task_of_table(path.stem, read_merl(path), samples, path)


def task_of_table(name: str, table: Doubles, samples: int, source: str | Path) -> Task:
    """Make the BRDF task of a table, whose samples are measured values.

    Each drawn angle moves to the centre of its bin, on its side of phi_d and phi_d + pi: only the pictures are
    interpolated. Invalid bins are left out, and so are bins that an earlier draw has, on either side, since a held-out
    sample must not have been seen; further draws replace them.

    Args:
        name: the name of the task.
        table: the table [90, 90, 180, 3] that :func:`read_merl` returns.
        samples: the number of samples.
        source: the file that errors name.

    Raises:
        ValueError: see :func:`data_tools.readers.brdf_task.make_brdf_task`; there are fewer bins than samples.
    """
    measured = _draw_table_samples(source, table, samples) if samples > 1 else None
    # interpolation reads at random places: channels side by side, and half the bytes, make it faster
    evaluate = partial(evaluate_merl, torch.from_numpy(table.astype(np.float32, order="C")))
    return brdf_task.make_measured_task(name, evaluate, samples, source, measured=measured)


def _draw_table_samples(source: str | Path, table: Doubles, samples: int) -> tuple[Tensor, Tensor]:
    """Draw distinct valid bins of a table.

    Returns:
        Angles [N, 3] in rad and reflectance [N, 3] in 1/sr.
    """
    allowed = torch.from_numpy(merl_valid_mask(table)).reshape(-1) & _bins_above_horizon()
    available = int(allowed.sum())
    if samples > available:
        raise ValueError(f"{source}: {available:,} valid bins, expected {samples:,} or more; take fewer samples.")

    def keep(draws: Tensor) -> Tensor:
        bins = merl_index(draws)
        inside = allowed[bins].nonzero()[:, 0]
        _, first = np.unique(bins[inside].numpy(), return_index=True)
        return inside[torch.from_numpy(np.sort(first))]

    draws = brdf_task.draw_sample_pool(source, samples, 0, keep)
    bins = merl_index(draws)
    angles = merl_centres().reshape(-1, 3)[bins]
    angles[:, 2] += torch.where(draws[:, 2] >= math.pi, math.pi, 0.0)
    return angles, torch.from_numpy(table.reshape(-1, 3)[bins.numpy()]).float()


@cache
def _bins_above_horizon() -> Tensor:
    """Return a mask of the bins whose centre has light and view above the horizon, [90 * 90 * 180]."""
    return is_above_horizon(merl_centres()).reshape(-1)


def read_merl(path: str | Path) -> Doubles:
    """Read the table of a MERL file: linear RGB reflectance [90, 90, 180, 3] in 1/sr, invalid entries negative.

    It is a view of planes, as the file has them: interleaving the channels can take longer than reading them.

    Raises:
        ValueError: the file is not a MERL file, or incomplete; values are not finite, or huge; almost no
            entries are valid.
    """
    path = Path(path)
    _check_file(path)
    planes = np.fromfile(path, dtype="<f8", offset=12).astype(np.float64, copy=False).reshape(3, *TABLE_SHAPE)
    _check_values(planes, str(path))
    planes *= CHANNEL_SCALES[:, None, None, None]
    return np.moveaxis(planes, 0, -1)


def write_merl(path: str | Path, table: Doubles) -> None:
    """Write a table that :func:`read_merl` returned as a MERL file, whole or not at all.

    Reading the file again gives the table's values up to their last bit.

    Raises:
        ValueError: the table has another shape; values are not finite or huge; almost no entries are valid.
    """
    if table.shape != (*TABLE_SHAPE, 3):
        raise ValueError(f"{path}: table {table.shape}, expected {(*TABLE_SHAPE, 3)} to write.")
    planes = np.stack([table[..., channel] / CHANNEL_SCALES[channel] for channel in range(3)])
    _check_values(planes, str(path))

    def write(partial: Path) -> None:
        with partial.open("wb") as stream:
            stream.write(_HEADER.tobytes())
            planes.astype("<f8", copy=False).tofile(stream)

    write_atomically(path, write)


def _check_file(path: Path) -> None:
    """Raise ValueError for a file that is not MERL's by its size and header."""
    if fault := _find_fault(path):
        raise ValueError(fault)


def _find_fault(path: Path) -> str:
    """Return the fault of a file's size or header; "" for none."""
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        return f"{path}: {found}, expected a MERL file; check the path."
    size = path.stat().st_size
    with open_regular(path) as stream:
        header = np.frombuffer(stream.read(12).ljust(12, b"\0"), dtype="<i4")
    matches = bool((header == _HEADER).all())
    if size != FILE_BYTES:
        if line := placeholder_line(path):
            return line
        remedy = "not a MERL file" if not matches else "the file has something appended, download it again"
        if matches and size < FILE_BYTES:
            remedy = "the download is probably incomplete"
        return f"{path}: {size:,} bytes, expected {_EXPECTED_SIZE}; {remedy}."
    found = "x".join(map(str, header.tolist()))
    return "" if matches else f"{path}: header {found}, expected 90x90x180; not a MERL file."


def _check_values(planes: Doubles, subject: str) -> None:
    """Raise ValueError for planes [3, 90, 90, 180] that no measurement gives."""
    # the sum is not finite if any value is not, and costs less than a test of each value
    with np.errstate(invalid="ignore", over="ignore"):
        total = planes.sum()
    if not np.isfinite(total) and not np.isfinite(planes).all():
        count = int((~np.isfinite(planes)).sum())
        raise ValueError(f"{subject}: {count:,} values are NaN or infinite, expected none; download or make it again.")
    highest = max(float(planes.max()), -float(planes.min()))
    if highest > MAX_FILE_VALUE:
        raise ValueError(
            f"{subject}: values of up to {highest:.3g}, expected at most {MAX_FILE_VALUE:.0e} in a MERL file; is it "
            "damaged, or in another unit?"
        )
    valid = float(merl_valid_mask(np.moveaxis(planes, 0, -1)).mean())
    if valid < _MIN_VALID_SHARE:
        raise ValueError(
            f"{subject}: {valid:.2%} of the entries are valid (not negative), expected {_MIN_VALID_SHARE:.0%} or more; "
            "not a measured BRDF."
        )


def merl_valid_mask(table: Doubles) -> NDArray[np.bool_]:
    """Return a mask [90, 90, 180] of a table's valid entries: those with a channel that is not negative."""
    return (table[..., 0] >= 0) | (table[..., 1] >= 0) | (table[..., 2] >= 0)


def merl_centres() -> Tensor:
    """Return the centres of all bins: angles (theta_h, theta_d, phi_d), float32 [90, 90, 180, 3] rad."""
    return torch.stack(torch.meshgrid(*(axis.float() for axis in _axis_centres()), indexing="ij"), dim=-1)


def merl_index(angles: Tensor) -> Tensor:
    """Return the flat index phi_d + 180 * (theta_d + 90 * theta_h), int64 [...], of the bin of angles [..., 3] rad.

    The thetas are clamped to 0..pi/2, and phi_d + pi is phi_d (reciprocity).
    """
    bins = [position.floor().long().clamp(0, size - 1)
            for position, size in zip(_bin_positions(angles), TABLE_SHAPE, strict=True)]  # fmt: skip
    return (bins[0] * TABLE_SHAPE[1] + bins[1]) * TABLE_SHAPE[2] + bins[2]


def evaluate_merl(table: Doubles | Tensor, angles: Tensor) -> Tensor:
    """Interpolate a table linearly at any angles.

    Invalid entries are left out and the rest weighs more; if all eight are invalid the result is 0. phi_d is periodic;
    beyond the outermost centres of theta_h and theta_d the outermost value holds.

    Args:
        table: the table [90, 90, 180, 3] in 1/sr; float32 is fastest.
        angles: theta_h, theta_d, phi_d in rad, [..., 3].

    Returns:
        Reflectance [..., 3] in 1/sr, >= 0, of the angles' type.
    """
    flat = torch.as_tensor(table, device=angles.device).reshape(-1, 3)
    lower, upper, weight = [], [], []
    for position, size, axis, angle in zip(
        _bin_positions(angles), TABLE_SHAPE, _axis_centres(), angles.unbind(-1), strict=True
    ):
        if size == TABLE_SHAPE[2]:
            first = (position - 0.5).floor()
            weight.append(position - 0.5 - first)
            lower.append(first.long() % size)
            upper.append((lower[-1] + 1) % size)
        else:
            first = (position - 0.5).floor().long().clamp(0, size - 2)
            centres = axis.to(angles)
            weight.append(((angle - centres[first]) / (centres[first + 1] - centres[first])).clamp(0, 1))
            lower.append(first)
            upper.append(first + 1)
    total = angles.new_zeros(angles.shape)
    weights = angles.new_zeros((*angles.shape[:-1], 1))
    for corner in range(8):
        index = torch.zeros_like(lower[0])
        share = torch.ones_like(weight[0])
        for dim, size in enumerate(TABLE_SHAPE):
            is_upper = corner >> dim & 1
            index = index * size + (upper[dim] if is_upper else lower[dim])
            share = share * (weight[dim] if is_upper else 1 - weight[dim])
        value = flat[index].to(angles.dtype)
        share = (share * (value >= 0).any(-1)).unsqueeze(-1)
        total += share * value
        weights += share
    return (total / weights.clamp_min(1e-12)).clamp_min(0)


def tabulate_merl(evaluate: Callable[[Tensor], Tensor]) -> Doubles:
    """Return the table [90, 90, 180, 3] of a BRDF at the centres of all bins; bins below the horizon are invalid.

    Args:
        evaluate: a function from float32 angles [N, 3] in rad, all above the horizon, to reflectance [N, 3] in 1/sr.
    """
    table = np.empty((*TABLE_SHAPE, 3))
    table[:] = -CHANNEL_SCALES
    # some theta_h at a time: a network's hidden layers for all bins at once would take hundreds of megabytes
    for rows, angles in zip(np.array_split(table, 9), merl_centres().tensor_split(9), strict=True):
        is_above = is_above_horizon(angles)
        with torch.no_grad():
            value = evaluate(angles[is_above])
        rows[is_above.numpy()] = value.clamp_min(0).double().cpu().numpy()
    return table


def _axis_centres() -> tuple[Tensor, Tensor, Tensor]:
    """Return the centres of the bins along theta_h, theta_d and phi_d, float64 rad."""
    theta_h, theta_d, phi_d = ((torch.arange(size, dtype=torch.float64) + 0.5) / size for size in TABLE_SHAPE)
    return theta_h**2 * (math.pi / 2), theta_d * (math.pi / 2), phi_d * math.pi


def _bin_positions(angles: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the positions of angles along the three axes, in bins: bin i covers [i, i + 1)."""
    theta_h, theta_d, phi_d = angles.unbind(-1)
    return (
        (theta_h.clamp_min(0) * (2 / math.pi)).sqrt() * TABLE_SHAPE[0],
        theta_d * (2 / math.pi * TABLE_SHAPE[1]),
        phi_d.remainder(math.pi) * (TABLE_SHAPE[2] / math.pi),
    )
