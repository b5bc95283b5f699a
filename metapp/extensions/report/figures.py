"""The figures that are offered: drawn and written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from metapp import door

if TYPE_CHECKING:
    from metapp.evaluation.style import Drawn
    from metapp.evaluation.subject import Subject


def figure_names(table: str = "") -> list[str]:
    """The figures of a study or, for "", the paper's."""
    return [offer.name for offer in door.offers(door.Figure) if offer.table == table]


def draw(name: str, subject: Subject) -> Drawn | None:
    """The figure of that name; None where nothing was measured yet that it could show."""
    from matplotlib import rc_context

    from metapp.evaluation.style import STYLE

    (reference,) = (offer.figure for offer in door.offers(door.Figure) if offer.name == name)
    with rc_context(STYLE):
        result: Drawn | None = door.load(reference)(subject)
        return result


def write_figures(subjects: Sequence[Subject], folder: Path, tables: Sequence[str]) -> list[Path]:
    """Write the figures of a study, if the tables are one, else the paper's, as <app>-<name>.png and .pdf.

    Returns:
        The PNG files.
    """
    from metapp.evaluation.style import save
    from metapp.runs.requests.naming import name_of

    files = []
    names = [name for table in tables for name in figure_names(table)] or figure_names()
    for subject in subjects:
        for name in names:
            drawn = draw(name, subject)
            if drawn:
                stem = f"{name_of(subject.app)} {name}".replace(" ", "-")
                files.append(save(drawn.figure, folder / f"{stem}.png"))
                save(drawn.figure, folder / f"{stem}.pdf")
    return files
