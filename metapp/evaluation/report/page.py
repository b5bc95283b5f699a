"""The page as a whole: what it says first, a section for each application, and how it was made."""

from __future__ import annotations

import datetime
import json
import os
import platform
import re
from collections.abc import Sequence
from html import escape
from importlib import resources
from pathlib import Path

from metapp.evaluation.figures import FIGURES, draw
from metapp.evaluation.report.gallery import gallery_html, records_of, tasks_html
from metapp.evaluation.report.glance import glance
from metapp.evaluation.report.html import Pictures, anchor, drawn_html, table_html
from metapp.evaluation.rows import paper
from metapp.evaluation.subject import Subject
from metapp.evaluation.tables import NAMES, load_table
from metapp.runs.surroundings import make_folder, versions
from metapp.storage.files import write_atomically

HEADINGS = {
    "results": "Error and time",
    "quickft": "Against as many steps of fine-tuning",
    "image": "In image space",
    "ablation": "Ablation: initialisation and rule",
    "storage": "Storage",
    "samples": "Samples seen",
    "convergence": "Convergence",
    "baselines": "Methods without a network",
}


def write_report(subjects: Sequence[Subject], folder: Path) -> Path:
    """Write `index.html`, of what has been measured so far.

    Returns:
        The file.
    """
    make_folder(folder)
    pictures = Pictures()
    sections = [section(subject, pictures) for subject in subjects]
    links = [f'<a href="#{anchor(subject)}">{escape(subject.title)}</a>' for subject in subjects]
    records = json.dumps({anchor(subject): records_of(subject) for subject in subjects}, allow_nan=False)
    parts = {
        "style": _text("page.css"),
        "script": _text("page.js"),
        "links": "".join([*links, '<a href="#made">How this was made</a>']),
        "body": "\n".join([glance(subjects, pictures), *sections, colophon(subjects)]),
        "records": records.replace("<", "\\u003c"),  # no record can end the script
    }
    page = re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], _text("page.html"))
    placed = pictures.place(page, folder)
    file = folder / "index.html"
    write_atomically(file, lambda partial: partial.write_text(placed, encoding="utf-8"))
    return file


def _text(name: str) -> str:
    return (resources.files("metapp.evaluation.report") / name).read_text(encoding="utf-8")


def section(subject: Subject, pictures: Pictures) -> str:
    """All there is of one application."""
    name = anchor(subject)
    figures = {kind: draw(kind, subject) for kind in FIGURES if kind != "plane"}
    drawn = {kind: drawn_html(d, f"{name}-{kind}", pictures, _kind(kind)) for kind, d in figures.items() if d}
    strips = drawn.pop("strips", "")
    gallery = gallery_html(subject, pictures)
    hint = "The reference beside five results; a click shows the record behind one."
    return "\n".join(
        [
            f'<section id="{name}"><h2>{escape(subject.title)}</h2>',
            _table("results", subject),
            f'<div class="figures">{"".join(drawn.values())}</div>' if drawn else "",
            f"<h3>Along the steps</h3>{strips}" if strips else "",
            f"<h3>Gallery</h3><p>{hint}</p>{gallery}" if gallery else "",
            tasks_html(subject),
            *(_table(table, subject) for table in NAMES[1:]),
            "</section>",
        ]
    )


def _kind(figure: str) -> str:
    return "figure broad" if figure == "trajectories" else "figure"


def _table(name: str, subject: Subject) -> str:
    table = load_table(name)
    rows = table.rows(subject)
    return f"<h3>{HEADINGS[name]}</h3>{table_html(table, subject, rows)}" if rows else ""


def colophon(subjects: Sequence[Subject]) -> str:
    """Versions, machine, data, commands, sources."""
    facts = {
        **versions(),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}",
        "made": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
    }
    if subjects:
        facts |= {"recipe": subjects[0].plan.request.recipe, "seed": str(subjects[0].plan.request.seed)}
    commands = dict.fromkeys(command for subject in subjects for command in _commands(subject))
    known = paper()
    sources = "".join(f"<li>{escape(key)}: {escape(text)}</li>" for key, text in known["sources"].items())
    return (
        f'<section id="made"><h2>How this was made</h2>{_facts(facts)}'
        f"<h3>Data</h3>{_facts({subject.title: subject.label for subject in subjects})}"
        f"<h3>Commands</h3><pre>{escape(chr(10).join(commands))}</pre>"
        f"<h3>The paper</h3><p>{escape(known['source'])}</p><ul class='notes'>{sources}</ul></section>"
    )


def _facts(facts: dict[str, str]) -> str:
    pairs = "".join(f"<dt>{escape(key)}</dt><dd>{escape(text)}</dd>" for key, text in facts.items())
    return f"<dl>{pairs}</dl>"


def _commands(subject: Subject) -> list[str]:
    return [subject.command("all"), *(subject.cell(name).command for name in subject.fits)]
