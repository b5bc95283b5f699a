"""The figures that are offered: drawn and written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from metapp import door

if TYPE_CHECKING:
    from metapp.evaluation.style import Drawn
    from metapp.evaluation.subject import Subject


def figure_names() -> list[str]:
    """The names of all figures."""
    return [offer.name for offer in door.offers(door.Figure)]


def draw(name: str, subject: Subject) -> Drawn | None:
    """The figure of that name; None where nothing was measured yet that it could show."""
    from matplotlib import rc_context

    from metapp.evaluation.style import STYLE

    (reference,) = (offer.figure for offer in door.offers(door.Figure) if offer.name == name)
    with rc_context(STYLE):
        result: Drawn | None = door.load(reference)(subject)
        return result


def write_figures(subjects: Sequence[Subject], folder: Path, tables: Sequence[str]) -> list[Path]:
    """Write the figures as <app>-<name>.png and .pdf.

    Returns:
        The PNG files.
    """
    from metapp.evaluation.style import save
    from metapp.runs.requests.naming import name_of

    files = []
    for subject in subjects:
        for name in figure_names():
            drawn = draw(name, subject)
            if drawn:
                stem = f"{name_of(subject.app)} {name}".replace(" ", "-")
                files.append(save(drawn.figure, folder / f"{stem}.png"))
                save(drawn.figure, folder / f"{stem}.pdf")
    return files
