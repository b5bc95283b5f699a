"""Repeat the records that tables alone make: those of baselines, and halves of learned rules."""

from __future__ import annotations

from typing import Any

from metapp.baselines import baselines_of
from metapp.evaluation.cell import Cell
from metapp.evaluation.subject import Subject
from metapp.evaluation.tables import ablation, baselines
from metapp.runs.plan import Plan
from metapp.runs.rerun import Repeat


def repeat_of(plan: Plan, settings: dict[str, Any]) -> Repeat | None:
    """What repeats a record of these settings, from the cells of its table; None where no table has such a cell."""
    cell = _cell(Subject(plan, run=True, strict=False), settings)
    return Repeat(cell.folder.settings, cell.tasks, cell.measure) if cell and cell.folder else None


def _cell(subject: Subject, settings: dict[str, Any]) -> Cell | None:
    if "peer" in settings:
        named = [baseline for baseline in baselines_of(subject.app) if baseline.name == settings["peer"]]
        return baselines.baseline_cell(subject, named[0]) if named else None
    names = (settings.get("paradigm"), settings.get("rule"))
    if names[0] not in (ablation.RULE_ALONE.name, ablation.START_ALONE.name):
        return None
    halves = [cell for name in ablation.learned(subject) for _, _, cell in ablation.combined(subject, name)]
    of = {(cell.folder.settings["paradigm"], cell.folder.settings["rule"]): cell for cell in halves if cell.folder}
    return of.get(names)
