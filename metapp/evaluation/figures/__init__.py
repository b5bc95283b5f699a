"""The paper's figures, of any application: functions of a subject that draw, or return None where there is nothing.

A figure is a function in `drawing` that FIGURES names, or STUDIES where it is of a table that trains.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metapp.evaluation.figures.style import Drawn
    from metapp.evaluation.subject import Subject

FIGURES = ("plane", "ranks", "curves", "trajectories", "rates", "strips")
STUDIES = ("rules",)  # of the tables of the same names


def draw(name: str, subject: Subject) -> Drawn | None:
    """The figure of that name, one of FIGURES or STUDIES; None where nothing was measured yet that it could show."""
    from matplotlib import rc_context

    from metapp.evaluation.figures import drawing
    from metapp.evaluation.figures.style import STYLE

    with rc_context(STYLE):
        result: Drawn | None = getattr(drawing, name)(subject)
        return result


def write_figures(subjects: Sequence[Subject], folder: Path, names: Sequence[str] = FIGURES) -> list[Path]:
    """Write figures as <app>-<name>.png and .pdf.

    Returns:
        The PNG files.
    """
    from metapp.evaluation.figures.style import save
    from metapp.runs.naming import name_of

    files = []
    for subject in subjects:
        for name in names:
            drawn = draw(name, subject)
            if drawn:
                stem = f"{name_of(subject.app)} {name}".replace(" ", "-")
                files.append(save(drawn.figure, folder / f"{stem}.png"))
                save(drawn.figure, folder / f"{stem}.pdf")
    return files
