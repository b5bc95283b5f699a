"""What the report says first: a card for each application, and the paper's table of results with ours."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from metapp.evaluation.figures import draw
from metapp.evaluation.figures.style import TITLES
from metapp.evaluation.notes import carried, overfit_note, warned
from metapp.evaluation.report.html import Pictures, anchor, drawn_html
from metapp.evaluation.rows import Row, paired_of, paper
from metapp.evaluation.subject import Subject
from metapp.evaluation.tables.results import result_row
from metapp.runs.naming import is_first_protocol
from metapp.runs.reporter import number
from metapp.runs.statistics import apart

TIMES = "&times;"


def glance(subjects: Sequence[Subject], pictures: Pictures) -> str:
    """Cards and the table."""
    cards = "".join(card(subject, pictures) for subject in subjects)
    return (
        f'<section id="glance"><h2>At a glance</h2><div class="cards">{cards}</div>'
        f"<h3>The paper's table of results</h3>{matrix(subjects)}</section>"
    )


def card(subject: Subject, pictures: Pictures) -> str:
    """One application: the quality-speed plane, the gap closed, the speed-up, and whether Meta wins."""
    rows = [result_row(subject, name) for name in TITLES]
    (gap, speed), (paper_gap, paper_speed) = (carried(rows, f"{of}error", f"{of}seconds") for of in ("", "paper_"))
    lines = [f"{_big(speed, ',.0f', TIMES)} as fast as Overfit {_small(paper_speed, ',.0f', TIMES)}"]
    if is_first_protocol(subject.app):
        lines.insert(0, f"{_big(gap, '.0%')} of the gap closed {_small(paper_gap, '.0%')}")
    lines += [badge(rows), *(f"<small>{escape(note)}</small>" for note in (*warned(rows), *overfit_note(subject)))]
    drawn = draw("plane", subject)
    picture = drawn_html(drawn, f"{anchor(subject)}-plane", pictures, "plain") if drawn else ""
    items = "".join(f"<li>{line}</li>" for line in lines)
    link = f'<a href="#{anchor(subject)}">{escape(subject.title)}</a>'
    return f"<article><h3>{link}</h3>{picture}<ul>{items}</ul></article>"


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
    top = "".join(f'<th scope="col" colspan="2">{escape(titles.get(name, by_name[name].title))}</th>' for name in names)
    below = "<th scope='col'>error</th><th scope='col'>seconds</th>" * len(names)
    body = ""
    for paradigm, title in TITLES.items():
        cells = "".join(_pair(by_name[name], paradigm) for name in names)
        body += f'<tr class="{paradigm}"><th scope="row" class="left">{title}</th>{cells}</tr>'
    caption = (
        "Mean error over unseen tasks and median seconds of inference; in small type the paper's, of its own data and "
        "machine. A dash: not measured here yet."
    )
    head = f"<thead><tr><td></td>{top}</tr><tr><td></td>{below}</tr></thead>"
    table = f'<table class="matrix"><caption>{caption}</caption>{head}<tbody>{body}</tbody></table>'
    return f'<div class="scroll">{table}</div>'


def _pair(subject: Subject, paradigm: str) -> str:
    row = result_row(subject, paradigm)
    ours = (number(row["error"], ".3f"), number(row["seconds"], ".3g"))
    theirs = (number(row["paper_error"], ".3f"), number(row["paper_seconds"], ".3f"))
    return "".join(f"<td>{one}<small>{other}</small></td>" for one, other in zip(ours, theirs, strict=True))
