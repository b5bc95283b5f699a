"""The style of all figures: colours that the colour-blind tell apart (Okabe & Ito 2008), sizes."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from metapp.storage.files import write_atomically

COLOURS = {
    "general": "#E69F00",
    "overfit": "#0072B2",
    "finetune": "#56B4E9",
    "quickft": "#CC79A7",
    "meta": "#D55E00",
}
MUTED = "#666666"
DPI = 160
INK, GRID = "#222222", "#d9d9d9"
STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.labelsize": 9,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.6,
    "pdf.fonttype": 42,  # text stays text
}


class Drawn(NamedTuple):
    """A figure and its description in words, for those who read it or hear it."""

    figure: Figure
    caption: str


def new(width: float, height: float, rows: int = 1, columns: int = 1) -> tuple[Figure, np.ndarray]:
    """A figure of so many inches, and its axes [rows, columns]."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def save(figure: Figure, path: Path) -> Path:
    """Write a figure in the format of the suffix. The same figure gives the same file."""
    metadata = {"CreationDate": None} if path.suffix == ".pdf" else {"Software": None}
    with rc_context(STYLE):
        write_atomically(path, functools.partial(figure.savefig, dpi=DPI, metadata=metadata))
    return path
