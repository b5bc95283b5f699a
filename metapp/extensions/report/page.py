"""The page: a card for each application and the paper's table, a section and a gallery for each, how it was made."""

from __future__ import annotations

import datetime
import os
import platform
import shlex
from collections.abc import Iterator, Sequence
from html import escape
from importlib import resources
from pathlib import Path

from metapp.appearance.colour import to_srgb
from metapp.evaluation.notes import carried, few_note, warned
from metapp.evaluation.rows import Row, paired_of, paper, values_of
from metapp.evaluation.subject import Subject, evenly, shared_words
from metapp.evaluation.tables import load_table
from metapp.evaluation.tables.results import result_row
from metapp.extensions.report.drawing import TITLES
from metapp.extensions.report.figures import FIGURES, draw
from metapp.extensions.report.html import (
    anchor,
    drawn_html,
    gallery_address,
    link_to,
    notes_html,
    scrolling,
    sortable_html,
    table_html,
)
from metapp.learning.task import Params, Task
from metapp.runs.outputs.statistics import apart
from metapp.runs.reporter import number
from metapp.runs.requests.naming import is_first_protocol
from metapp.runs.requests.plan import Plan
from metapp.runs.surroundings import make_folder, versions
from metapp.storage import html
from metapp.storage.html import element
from metapp.storage.records import Record

TASKS = 8  # of a gallery
TIMES = "&times;"
TITLE = "Metappearance, reproduced"
ABOUT = (
    "Small networks that reproduce visual appearance, trained in five ways: how good they become, and how fast. Each "
    "of our figures was computed from the records behind it; the paper's stand beside them."
)
DIALOG = (
    '<dialog id="record" aria-label="The record behind a picture"><form method="dialog"><button>Close</button></form>'
    '<div id="shown"></div></dialog>'
)


def write_report(subjects: Sequence[Subject], folder: Path, tables: Sequence[str]) -> list[Path]:
    """Write `index.html`, of what has been measured so far.

    Args:
        subjects: of which applications.
        folder: made if missing.
        tables: that it has, by name.

    Returns:
        The file.
    """
    make_folder(folder)
    sections = [section(subject, tables) for subject in subjects]
    page = html.page(
        TITLE,
        _text("page.css"),
        element("header", element("h1", TITLE), element("p", ABOUT)),
        element("nav", *map(link_to, subjects), '<a href="#made">How this was made</a>', aria_label="Applications"),
        element("main", glance(subjects), *sections, colophon(subjects, tables)),
        DIALOG,
        html.data_script("records", {anchor(subject): records_of(subject) for subject in subjects}),
        element("script", _text("page.js")),
    )
    return [html.write_page(page, folder / "index.html")]


def _text(name: str) -> str:
    return (resources.files("metapp.extensions.report") / name).read_text(encoding="utf-8")


def section(subject: Subject, tables: Sequence[str]) -> str:
    """All there is of one application, and these of its tables."""
    figures = {name: draw(name, subject) for name in FIGURES if name != "plane"}
    widths = {"trajectories": "figure broad"}
    drawn = {name: drawn_html(one, widths.get(name, "figure")) for name, one in figures.items() if one}
    strips = drawn.pop("strips", "")
    gallery = gallery_html(subject)
    hint = "The reference beside five results; a click shows the record behind one."
    return "\n".join(
        [
            f'<section id="{anchor(subject)}">',
            element("h2", escape(subject.title)),
            _table("results", subject) if "results" in tables else "",
            f'<div class="figures">{"".join(drawn.values())}</div>' if drawn else "",
            f"<h3>Along the steps</h3>{strips}" if strips else "",
            f"<h3>Gallery</h3><p>{hint}</p>{gallery}" if gallery else "",
            tasks_html(subject),
            *(_table(table, subject) for table in tables if table != "results"),
            "</section>",
        ]
    )


def _table(name: str, subject: Subject) -> str:
    table = load_table(name)
    rows = table.rows(subject)
    return f"<h3>{escape(table.heading or name)}</h3>{table_html(table, subject, rows)}" if rows else ""


def colophon(subjects: Sequence[Subject], tables: Sequence[str]) -> str:
    """Versions, machine, data, commands, sources."""
    facts = {
        **versions(),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}",
        "made": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
    }
    if subjects:
        facts |= {"recipe": subjects[0].plan.request.recipe, "seed": str(subjects[0].plan.request.seed)}
    which = tables[0] if len(tables) == 1 else "all"
    commands = dict.fromkeys(command for subject in subjects for command in _commands(subject, which))
    published = paper()
    return element(
        "section",
        element("h2", "How this was made"),
        _facts(facts),
        element("h3", "Data"),
        _facts({subject.title: subject.label for subject in subjects}),
        element("h3", "Commands"),
        element("pre", escape("\n".join(commands))),
        element("h3", "The paper"),
        element("p", escape(published["source"])),
        notes_html(f"{key}: {text}" for key, text in published["sources"].items()),
        id="made",
    )


def _facts(facts: dict[str, str]) -> str:
    pairs = (element("dt", escape(key)) + element("dd", escape(text)) for key, text in facts.items())
    return element("dl", *pairs)


def _commands(subject: Subject, which: str) -> list[str]:
    return [subject.command(which), *map(_fit_command, subject.fits.values())]


def _fit_command(plan: Plan) -> str:
    """The command that makes what is missing of a paradigm's fits."""
    request = plan.request
    words = ["metapp", request.paradigm, plan.app.name, *shared_words(plan)]
    words += ["--steps", str(request.steps)] if request.steps is not None else []
    words += ["--rule", request.rule] if request.paradigm == "meta" else []
    return shlex.join(words + (["--train"] if plan.checkpoint is None else []))


# What the report says first


def glance(subjects: Sequence[Subject]) -> str:
    """Cards and the table."""
    cards = map(card, subjects)
    return element(
        "section",
        element("h2", "At a glance"),
        element("div", *cards, class_="cards"),
        element("h3", "The paper's table of results"),
        matrix(subjects),
        id="glance",
    )


def card(subject: Subject) -> str:
    """One application: the quality-speed plane, the gap closed, the speed-up, and whether Meta wins."""
    rows = [result_row(subject, name) for name in TITLES]
    gap, speed = carried(rows, "shared_error", "seconds")
    paper_gap, paper_speed = carried(rows, "paper_error", "paper_seconds")
    lines = [f"{_big(speed, ',.0f', TIMES)} as fast as Overfit {_small(paper_speed, ',.0f', TIMES)}"]
    if is_first_protocol(subject.app):
        lines.insert(0, f"{_big(gap, '.0%')} of the gap closed {_small(paper_gap, '.0%')}")
    lines += [badge(rows), *(element("small", escape(note)) for note in (*warned(rows), *few_note(subject)))]
    drawn = draw("plane", subject)
    picture = drawn_html(drawn, "plain") if drawn else ""
    items = element("ul", *(element("li", line) for line in lines))
    return element("article", element("h3", link_to(subject)), picture, items)


def _big(value: float | None, form: str, unit: str = "") -> str:
    return f"<b>{number(value, form)}{unit if value is not None else ''}</b>"


def _small(value: float | None, form: str, unit: str = "") -> str:
    return f"<small>(paper {number(value, form)}{unit})</small>" if value is not None else ""


def badge(rows: list[Row]) -> str:
    """Meta against QuickFT, which takes as many steps: a lower error, a higher one, or no win."""
    meta = next(row for row in rows if row["paradigm"] == "meta")
    pair = paired_of(meta, "quickft")
    if pair is None:
        return '<span class="badge">not measured yet</span>'
    kind, text = "", "no win over QuickFT"
    if apart(pair) is None:
        text = "too few tasks to call a win over QuickFT"
    elif apart(pair):
        lower = pair.value < pair.level
        kind, text = (" win", "a lower error than QuickFT") if lower else (" loss", "a higher error than QuickFT")
    figures = f"{pair.kind} of errors {pair}, lower on {pair.ahead} of {pair.tasks} tasks"
    return f'<span class="badge{kind}">{text}</span> <small>{escape(figures)}</small>'


def matrix(subjects: Sequence[Subject]) -> str:
    """Paradigms by applications: error and seconds, the paper's below in small."""
    titles = paper()["titles"]
    by_name: dict[str, Subject] = {subject.app.name: subject for subject in subjects if is_first_protocol(subject.app)}
    names = [*(name for name in titles if name in by_name), *(name for name in by_name if name not in titles)]
    headings = (escape(titles.get(name, by_name[name].title)) for name in names)
    top = (element("th", heading, scope="col", colspan="2") for heading in headings)
    below = [element("th", heading, scope="col") for heading in ("error", "seconds")] * len(names)
    body = []
    for paradigm, title in TITLES.items():
        cells = (_pair(by_name[name], paradigm) for name in names)
        body.append(element("tr", element("th", title, scope="row", class_="left"), *cells, class_=paradigm))
    caption = (
        "Mean error over unseen tasks and median seconds of inference; in small type the paper's, of its own data and "
        "machine. A dash: not measured here yet. *: of some of the tasks, as notes below the application's table say."
    )
    head = [element("tr", element("td"), *cells) for cells in (top, below)]
    return scrolling(html.table(head, body, caption, class_="matrix"))


def _pair(subject: Subject, paradigm: str) -> str:
    row = result_row(subject, paradigm)
    ours = (number(row["error"], ".3f") + "*" * row["few"], number(row["seconds"], ".3g"))
    theirs = (number(row["paper_error"], ".3f"), number(row["paper_seconds"], ".3f"))
    return "".join(element("td", one, element("small", other)) for one, other in zip(ours, theirs, strict=True))


# The gallery: the reference beside the fit of every paradigm, each with the record behind it


def gallery_html(subject: Subject) -> str:
    """Up to TASKS tasks, evenly spaced, a row each; a click on a fit shows its record."""
    rows = [_task_html(subject, task) for task in evenly(subject.tasks, TASKS)]
    return element("div", *rows, class_="gallery") if any(rows) else ""


def _task_html(subject: Subject, task: Task) -> str:
    """The reference and the fits of one task; "" where none was fitted yet."""
    figures: list[str] = []
    for name, record, theta in fits_of(subject, task):
        title, pictures = TITLES[name], subject.presentation.outputs(theta, task)
        if not figures and "reference" in pictures:
            address = gallery_address(to_srgb(pictures["reference"]))
            figures.append(html.figure(html.image(address, f"{task.name}: reference"), "Reference"))
        address = gallery_address(to_srgb(pictures["fit"]))
        result = f"{number(record['error'], '.3f')}, {record['seconds']:.3g} s"
        picture = html.image(address, f"{task.name}: {title}, error {result}")
        record_of = {"data_of": anchor(subject), "data_row": name, "data_task": task.name}
        button = element("button", picture, class_="record", **record_of)
        figures.append(html.figure(button, f"{element('b', title)} {escape(result)}", class_=name))
    row = element("div", *figures, class_="row")
    return element("div", element("h4", escape(task.name)), row, class_="task") if figures else ""


def fits_of(subject: Subject, task: Task) -> Iterator[tuple[str, Record, Params]]:
    """The fits of a task that there are: the paradigm, the record, the parameters."""
    for name in TITLES:
        cell = subject.cell(name)
        record = next((record for record in cell.records() if record["name"] == task.name), None)
        if record is not None and cell.folder is not None:
            yield name, record, cell.folder.theta(task.name)


def records_of(subject: Subject) -> Record:
    """All records of the fits, by row and task, and the settings that each run's share, once."""
    rows: dict[str, Record] = {}
    settings: Record = {}
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
    return element("details", element("summary", f"Errors of all {len(subject.tasks)} tasks"), table)
