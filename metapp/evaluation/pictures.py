"""Fits of several methods side by side, one picture an application."""

from __future__ import annotations

from pathlib import Path

from metapp.evaluation.cell import Cell
from metapp.evaluation.subject import Subject
from metapp.evaluation.tables.baselines import picture_cells
from metapp.runs.pictures import COMPARED, picture_of_table
from metapp.runs.reporter import progress


def draw_paradigms(subject: Subject) -> Path | None:
    """Draw the fits of all paradigms that are complete; None where none is."""
    cells = {name: subject.cell(name) for name, fit in subject.fits.items() if name == fit.paradigm.name}
    return _draw(subject, {name: cell for name, cell in cells.items() if _complete(cell)}, "comparison")


def draw_baselines(subject: Subject) -> Path | None:
    """Draw Meta's fits and those of baselines that are pictures; None where either is missing."""
    meta, others = subject.cell("meta"), picture_cells(subject)
    return _draw(subject, {"meta": meta} | others, "baselines") if others and _complete(meta) else None


def _complete(cell: Cell) -> bool:
    return bool(cell.folder and cell.tasks and not cell.missing())


def _draw(subject: Subject, cells: dict[str, Cell], kind: str) -> Path | None:
    request, app = subject.plan.request, subject.app
    words = [kind, subject.label, request.recipe]
    words += [f"seed{request.seed}", *filter(None, [app.protocol])] if kind == "comparison" else []
    runs = [(name, cell.folder.path, cell.records()) for name, cell in cells.items() if cell.folder]
    if not runs:
        return None
    file = request.out / app.name / f"{'-'.join(words)}.png"
    with progress(f"pictures of {subject.title}", len(subject.tasks[:COMPARED]), quiet=request.quiet) as bar:
        return picture_of_table(app, subject.tasks, runs, file, bar.advance)
