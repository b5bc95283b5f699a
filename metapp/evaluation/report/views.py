"""Interactive pages beside the report: fits of some tasks by every paradigm, side by side."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import torch

from metapp.evaluation.figures.style import TITLES
from metapp.evaluation.report.html import anchor
from metapp.evaluation.subject import Subject, evenly
from metapp.learning.task import Params, Task
from metapp.runs.viewing import shown_of
from metapp.storage.records import Record
from metapp.viewer.page import Group, document, write_page

TASKS = 3  # of a page


def write_view(subject: Subject, folder: Path) -> str:
    """Write the page of an application's fits into the report's folder.

    Returns:
        The file's name; "" where nothing was fitted yet.
    """
    groups = [group for task in evenly(subject.tasks, TASKS) if (group := _group(subject, task)).fits]
    if not groups:
        return ""
    file = folder / f"view-{anchor(subject)}.html"
    return write_page(document(f"metapp: {subject.title}", groups), file).name


@torch.no_grad()
def _group(subject: Subject, task: Task) -> Group:
    shown = [
        shown_of(subject.presentation, TITLES[name], record, theta, task, quick=True)
        for name, record, theta in fits_of(subject, task)
    ]
    return Group(task.name, subject.title, shown)


def fits_of(subject: Subject, task: Task) -> Iterator[tuple[str, Record, Params]]:
    """The fits of a task that there are: the paradigm, the record, the parameters."""
    for name in TITLES:
        cell = subject.cell(name)
        record = next((record for record in cell.records() if record["name"] == task.name), None)
        if record is not None and cell.folder is not None:
            yield name, record, cell.folder.theta(task.name)
