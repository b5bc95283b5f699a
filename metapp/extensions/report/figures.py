"""All figures: drawn and written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib import rc_context

from metapp.evaluation.style import STYLE, Drawn, save
from metapp.evaluation.subject import Subject
from metapp.extensions.report.drawing import curves, plane, ranks, rates, strips, trajectories
from metapp.runs.requests.naming import name_of

FIGURES = {drawing.__name__: drawing for drawing in (plane, ranks, curves, trajectories, rates, strips)}


def draw(name: str, subject: Subject) -> Drawn | None:
    """The figure of that name; None where nothing was measured yet that it could show."""
    with rc_context(STYLE):
        return FIGURES[name](subject)


def write_figures(subjects: Sequence[Subject], folder: Path, tables: Sequence[str]) -> list[Path]:
    """Write the figures as <app>-<name>.png and .pdf.

    Returns:
        The PNG files.
    """
    files = []
    for subject in subjects:
        for name in FIGURES:
            drawn = draw(name, subject)
            if drawn:
                stem = f"{name_of(subject.app)} {name}".replace(" ", "-")
                files.append(save(drawn.figure, folder / f"{stem}.png"))
                save(drawn.figure, folder / f"{stem}.pdf")
    return files
