"""Fits of several methods side by side, one picture an application."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from metapp.evaluation.cell import Cell
from metapp.evaluation.subject import Subject
from metapp.runs.outputs.pictures import COMPARED, picture_of_table
from metapp.runs.reporter import progress


def draw_paradigms(subject: Subject) -> Path | None:
    """Draw the fits of all paradigms that are complete; None where none is."""
    cells = {name: subject.cell(name) for name, fit in subject.fits.items() if name == fit.paradigm.name}
    return draw_cells(subject, {name: cell for name, cell in cells.items() if cell.whole}, "comparison")


def draw_cells(subject: Subject, cells: Mapping[str, Cell], kind: str) -> Path | None:
    """Draw fits that are complete, by their names; None where there are none."""
    options, app = subject.plan.options, subject.app
    words = [kind, subject.label, options.recipe, f"seed{options.seed}", *filter(None, [app.protocol])]
    runs = [(name, cell.records()) for name, cell in cells.items() if cell.fits]
    if not runs:
        return None
    file = options.out / app.name / f"{'-'.join(words)}.png"
    tasks = min((list(cell.tasks) for cell in cells.values()), key=len)
    with progress(f"pictures of {subject.title}", len(tasks[:COMPARED]), quiet=options.quiet) as bar:
        return picture_of_table(app, tasks, runs, file, bar.advance)
