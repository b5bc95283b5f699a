"""Curves as text: one number y a line, evenly spaced in x."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from data_tools.formats import Command, Format

if TYPE_CHECKING:
    from metapp.learning.task import Task

HELP = """Convert curves, text files of 32 numbers.

Example:
  metapp data curve curves --out set
"""
UNITS = {"y": "1"}


def recognises(path: Path) -> bool:
    """Return whether a path is a .curve file, or a folder with such files."""
    return any(path.glob("*.curve")) if path.is_dir() else path.suffix == ".curve"


def find(paths: Iterable[Path]) -> tuple[list[Path], list[str]]:
    """Find curves, those of a folder sorted."""
    return [file for path in paths for file in (sorted(path.glob("*.curve")) if path.is_dir() else [path])], []


def read_task(path: Path) -> Task:
    """Read a curve.

    Raises:
        ValueError: not 32 numbers.
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


FORMATS = (
    Format(
        "curve",
        "curve",
        __name__,  # larger formats have a module of data_tools.readers
        ".curve files of 32 numbers",
        command=Command(HELP, "curve", "FILES...", ".curve files, and folders of them."),
    ),
)
