"""The paper's sample efficiency: how much a fit sees of a task, and the transmission that saves."""

from __future__ import annotations

from metapp.evaluation.rows import Row, Table, blank, columns, numbers, paper
from metapp.evaluation.subject import Subject
from metapp.runs.naming import observe_of
from metapp.runs.plan import Plan


def rows(subject: Subject) -> list[Row]:
    """For each paradigm, the samples that its encoder and its steps see, at most all there are."""
    all_rows = [_row(subject, name, fit) for name, fit in subject.fits.items()]
    for row in all_rows:
        if row["paradigm"] == "meta":
            row["paper_saved"] = paper()["samples"].get(subject.app.name, {}).get("saved")
    return all_rows


def _row(subject: Subject, name: str, fit: Plan) -> Row:
    batch = fit.job.recipe.batch
    row = blank(subject.app.name, name, beside_paper=False, **observe_of(subject.app))
    row |= {"steps": fit.steps, "batch": batch if fit.steps else None}
    row |= dict.fromkeys(("seen", "all", "seen_bytes", "all_bytes", "saved", "paper_saved"))
    visible = subject.presentation.visible(subject.tasks[0]) if subject.tasks else None
    if visible is None:
        return row
    encodes = "general" in fit.paradigm.needs(fit.job) or bool(fit.checkpoint and fit.checkpoint.prepared.encoder)
    count = min(fit.steps * batch + (visible.encoder if encodes else 0), visible.samples)
    return row | {
        "tasks": len(subject.tasks),
        "seen": count,
        "all": visible.samples,
        "seen_bytes": count * visible.size,
        "all_bytes": visible.samples * visible.size,
        "saved": 1 - count / visible.samples,
    }


def notes(subject: Subject, all_rows: list[Row]) -> list[str]:
    """What a sample is here, and in the paper."""
    if all(row["seen"] is None for row in all_rows):
        return ["how much a fit may see of a task is not known, or there are no tasks yet"]
    lines = ["of what fits may see; samples that are drawn twice are sent once, so 'seen' is an upper bound"]
    if all_rows[0]["all"] == 1:
        lines.append("each step sees the whole task: nothing to save")
    if known := paper()["samples"].get(subject.app.name):
        meta = next(row["seen"] for row in all_rows if row["paradigm"] == "meta")
        saved = f"{1 - min(meta, known['all']) / known['all']:.1%}"
        lines.append(f"paper: meta sees {known['seen']:,} of {known['all']:,}; ours, of so many: saved {saved}")
    return lines


COLUMNS = columns(
    "paradigm",
    numbers("seen", "seen", ",d"),
    numbers("of", "all", ",d"),
    numbers("saved", "saved", ".1%"),
    numbers("paper saved", "paper_saved", ".1%"),
    numbers("bytes seen", "seen_bytes", ",d"),
    numbers("bytes of all", "all_bytes", ",d"),
    numbers("steps", "steps", ",d"),
    numbers("batch", "batch", ",d"),
)
TABLE = Table("samples", "samples and bytes of a task that a fit sees", COLUMNS, rows, notes)
