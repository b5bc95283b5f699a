"""The style of figures: matplotlib's rcParams, colours that the colour-blind tell apart (Okabe & Ito 2008)."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

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
STYLE: Any = {
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "figure.constrained_layout.use": True,
    "font.size": 9,
    "grid.color": "#d9d9d9",
    "legend.frameon": False,
    "pdf.fonttype": 42,  # text stays text
    "savefig.dpi": 160,
}


def save(figure: Figure, path: Path) -> Path:
    """Write a figure in the format of the suffix, without a date, so that files of equal figures are equal."""
    metadata = {"CreationDate": None} if path.suffix == ".pdf" else {"Software": None}
    with rc_context(STYLE):
        write_atomically(path, functools.partial(figure.savefig, metadata=metadata))
    return path
