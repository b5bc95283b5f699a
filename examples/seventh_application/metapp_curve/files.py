"""Curves as text files: one number y a line, evenly spaced in x."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from data_tools.readers.input_source import Source, Sources

if TYPE_CHECKING:
    from metapp.learning.task import Task

UNITS = {"y": "1"}


def recognises(path: Path) -> bool:
    """Return whether a path is a .curve file, or a folder with such files."""
    return any(path.glob("*.curve")) if path.is_dir() else path.suffix == ".curve"


def find(path: Path) -> Sources:
    """Find the curves of a path: a file, or the files of a folder, sorted by name."""
    files = sorted(path.glob("*.curve")) if path.is_dir() else [path]
    return [Source(file.stem, file) for file in files], []


def read_task(path: Path) -> Task:
    """Read a curve as a task, named by its file.

    Raises:
        ValueError: the file holds other than 32 numbers.
    """
    import torch

    from metapp.learning.task import Task

    try:
        values = [float(line) for line in path.read_text().split()]
    except ValueError:
        raise ValueError(f"{path}: not readable as numbers, expected 32, one a line.") from None
    if len(values) != 32:
        raise ValueError(f"{path}: {len(values)} numbers, expected 32; resample the curve.")
    return Task(path.stem, {"y": torch.tensor(values)})
