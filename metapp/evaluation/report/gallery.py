"""The gallery: the reference beside the fit of every paradigm, each with the record behind it."""

from __future__ import annotations

from html import escape
from typing import Any

from metapp.evaluation.figures.style import TITLES
from metapp.evaluation.report.html import Pictures, anchor, details_html, identifier, image_html, sortable_html
from metapp.evaluation.rows import values_of
from metapp.evaluation.subject import Subject, evenly
from metapp.learning.task import Task
from metapp.runs.naming import name_of
from metapp.runs.pictures import to_srgb
from metapp.runs.reporter import number

SHOWN = 8  # tasks


def gallery_html(subject: Subject, pictures: Pictures) -> str:
    """Up to SHOWN tasks, evenly spaced, a row each; a click on a fit shows its record."""
    rows = [_task_html(subject, task, pictures) for task in evenly(subject.tasks, SHOWN)]
    return f'<div class="gallery">{"".join(rows)}</div>' if any(rows) else ""


def _task_html(subject: Subject, task: Task, pictures: Pictures) -> str:
    """The reference and the fits of one task; "" where none was fitted yet."""
    shown: list[str] = []
    for name, title in TITLES.items():
        cell = subject.cell(name)
        record = next((record for record in cell.records() if record["name"] == task.name), None)
        if record is None or cell.folder is None:
            continue
        made = subject.presentation.outputs(cell.folder.theta(task.name), task)
        key = (name_of(subject.app), task.name)
        if not shown and "reference" in made:
            address = pictures.add_array(identifier(*key, "reference"), to_srgb(made["reference"]))
            image = image_html(address, f"{task.name}: reference")
            shown.append(f"<figure>{image}<figcaption>Reference</figcaption></figure>")
        address = pictures.add_array(identifier(*key, name), to_srgb(made["fit"]))
        result = f"{number(record['error'], '.3f')}, {record['seconds']:.3g} s"
        image = image_html(address, f"{task.name}: {title}, error {result}")
        button = f'data-of="{anchor(subject)}" data-row="{name}" data-task="{escape(task.name)}"'
        shown.append(
            f'<figure class="{name}"><button class="record" {button}>{image}</button>'
            f"<figcaption><b>{title}</b> {escape(result)}</figcaption></figure>"
        )
    row = f'<div class="row">{"".join(shown)}</div>'
    return f'<div class="task"><h4>{escape(task.name)}</h4>{row}</div>' if shown else ""


def records_of(subject: Subject) -> dict[str, Any]:
    """All records of the fits, by row and task, and the settings that each run's share, once."""
    rows: dict[str, dict[str, Any]] = {}
    settings: dict[str, Any] = {}
    for name in subject.fits:
        for record in subject.cell(name).records():
            settings[record["key"]] = record["settings"]
            rows.setdefault(name, {})[record["name"]] = {k: v for k, v in record.items() if k != "settings"}
    return {"records": rows, "settings": settings}


def tasks_html(subject: Subject) -> str:
    """The error of every task by every paradigm, which can be sorted."""
    errors = {name: values_of(subject.cell(name)) for name in subject.fits if subject.cell(name).records()}
    if not errors:
        return ""
    body = [
        [task.name, *(number(of_row.get(task.name), ".3f") for of_row in errors.values())] for task in subject.tasks
    ]
    table = sortable_html([("task", True), *((name, False) for name in errors)], body)
    return details_html(f"Errors of all {len(subject.tasks)} tasks", table)
