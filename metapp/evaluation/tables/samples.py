"""The paper's sample efficiency: how much a fit sees of a task, and the transmission that saves."""

from __future__ import annotations

from metapp.evaluation.tables.rows import Row, blank, numbers, paper, words
from metapp.evaluation.tables.subject import Cell, Subject
from metapp.evaluation.tables.table import Table
from metapp.runs.naming import observe_of


def cells(subject: Subject) -> list[Cell]:
    """Nothing has to be run."""
    return []


def rows(subject: Subject) -> list[Row]:
    """For each paradigm, the samples that its encoder and its steps see, at most all there are."""
    found = []
    visible = subject.presentation.visible(subject.tasks[0]) if subject.tasks else None
    for name, fit in subject.fits.items():
        steps = fit.plan.steps
        drawn = steps * fit.plan.job.recipe.batch
        row = blank(subject.app.name, name, **observe_of(subject.app)) | {
            "paper_error": None,
            "paper_seconds": None,
            "steps": steps,
            "batch": fit.plan.job.recipe.batch if steps else None,
            **dict.fromkeys(("seen", "all", "seen_bytes", "all_bytes", "saved", "paper_saved")),
        }
        if visible:
            reads = "general" in fit.plan.paradigm.needs(fit.plan.job)
            reads = reads or bool(fit.plan.checkpoint and fit.plan.prepared.encoder)
            seen = min(drawn + (visible.encoder if reads else 0), visible.samples)
            row |= {
                "tasks": len(subject.tasks),
                "seen": seen,
                "all": visible.samples,
                "seen_bytes": seen * visible.size,
                "all_bytes": visible.samples * visible.size,
                "saved": 1 - seen / visible.samples,
            }
        if name == "meta":
            row["paper_saved"] = paper()["samples"].get(subject.app.name, {}).get("saved")
        found.append(row)
    return found


def notes(subject: Subject, found: list[Row]) -> list[str]:
    """What a sample is here, and in the paper."""
    if all(row["seen"] is None for row in found):
        return ["how much a fit may see of a task is not said, or there are no tasks yet"]
    said = ["of what fits may see; samples that are drawn twice are sent once, so 'seen' is an upper bound"]
    if found[0]["all"] == 1:
        said.append("each step sees the whole task: nothing to save")
    told = paper()["samples"].get(subject.app.name)
    if told:
        meta = next(row["seen"] for row in found if row["paradigm"] == "meta")
        said.append(
            f"paper: meta sees {told['seen']:,} of {told['all']:,}; ours, of so many: saved {_saved(meta, told)}"
        )
    return said


def _saved(seen: int, told: dict[str, int]) -> str:
    return f"{1 - min(seen, told['all']) / told['all']:.1%}"


TABLE = Table(
    "samples",
    "samples and bytes of a task that a fit sees",
    (
        words("paradigm", "paradigm"),
        numbers("seen", "seen", ",d"),
        numbers("of", "all", ",d"),
        numbers("saved", "saved", ".1%"),
        numbers("paper saved", "paper_saved", ".1%"),
        numbers("bytes seen", "seen_bytes", ",d"),
        numbers("bytes of all", "all_bytes", ",d"),
        numbers("steps", "steps", ",d"),
        numbers("batch", "batch", ",d"),
    ),
    cells,
    rows,
    notes,
)
