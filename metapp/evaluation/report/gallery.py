"""The gallery: the reference beside the fit of every paradigm, each with the record behind it."""

from __future__ import annotations

from html import escape
from typing import Any

from metapp.evaluation.figures.style import TITLES
from metapp.evaluation.report.html import Pictures, anchor, identifier
from metapp.evaluation.subject import Subject, evenly
from metapp.learning.task import Task
from metapp.runs.naming import name_of
from metapp.runs.pictures import to_srgb
from metapp.runs.reporter import number

SHOWN = 8  # tasks
Records = dict[str, dict[str, Any]]


def gallery_html(subject: Subject, pictures: Pictures) -> str:
    """Up to SHOWN tasks, evenly spaced, a row each; a click on a fit shows its record."""
    rows = [_task_html(subject, task, pictures) for task in evenly(subject.tasks, SHOWN)]
    rows = [row for row in rows if row]
    return f'<div class="gallery">{"".join(rows)}</div>' if rows else ""


def _task_html(subject: Subject, task: Task, pictures: Pictures) -> str:
    """The reference and the fits of one task; "" where none was fitted yet."""
    shown = ""
    for name, title in TITLES.items():
        cell = subject.cell(name)
        record = next((each for each in cell.records() if each["name"] == task.name), None)
        if record is None or cell.folder is None:
            continue
        theta = cell.folder.theta(task.name)
        made = subject.presentation.outputs(theta, task)
        if not shown and "reference" in made:
            address = pictures.add_array(
                identifier(name_of(subject.app), task.name, "reference"), to_srgb(made["reference"])
            )
            alt = escape(f"{task.name}: reference")
            shown += (
                f'<figure><img loading="lazy" src="{address}" alt="{alt}"><figcaption>Reference</figcaption></figure>'
            )
        address = pictures.add_array(identifier(name_of(subject.app), task.name, name), to_srgb(made["fit"]))
        said = f"{number(record['error'], '.3f')}, {record['seconds']:.3g} s"
        alt = escape(f"{task.name}: {title}, error {said}")
        shown += (
            f'<figure class="{name}"><button class="record" data-of="{anchor(subject)}" data-row="{name}" '
            f'data-task="{escape(task.name)}"><img loading="lazy" src="{address}" alt="{alt}"></button>'
            f"<figcaption><b>{title}</b> {escape(said)}</figcaption></figure>"
        )
    return f'<div class="task"><h4>{escape(task.name)}</h4><div class="row">{shown}</div></div>' if shown else ""


def records_of(subject: Subject) -> dict[str, Any]:
    """All records of the fits, by row and task, and the settings that each run's share, once."""
    rows: dict[str, Records] = {}
    settings: dict[str, Any] = {}
    for name in subject.fits:
        for record in subject.cell(name).records():
            settings[record["key"]] = record["settings"]
            rows.setdefault(name, {})[record["name"]] = {k: v for k, v in record.items() if k != "settings"}
    return {"records": rows, "settings": settings}


def tasks_html(subject: Subject) -> str:
    """The error of every task by every paradigm, which can be sorted."""
    found = records_of(subject)["records"]
    if not found:
        return ""
    head = "".join(f'<th scope="col" aria-sort="none"><button>{escape(name)}</button></th>' for name in found)
    body = "".join(
        f'<tr><th scope="row" class="left">{escape(task.name)}</th>'
        + "".join(f"<td>{number(found[name].get(task.name, {}).get('error'), '.3f')}</td>" for name in found)
        + "</tr>"
        for task in subject.tasks
    )
    first = '<th scope="col" class="left" aria-sort="none"><button>task</button></th>'
    said = f"Errors of all {len(subject.tasks)} tasks"
    table = f"<table class='sortable'><thead><tr>{first}{head}</tr></thead><tbody>{body}</tbody></table>"
    return f"<details><summary>{said}</summary><div class='scroll'>{table}</div></details>"
