"""Repeat rows of tables that no paradigm's command makes: baselines, and halves of a learned rule's row."""

from __future__ import annotations

from metapp.baselines import baselines_of
from metapp.evaluation.cell import Cell
from metapp.evaluation.subject import Subject
from metapp.evaluation.tables import ablation, baselines
from metapp.runs.plan import Plan
from metapp.storage.records import Record


def cell_of(plan: Plan, settings: Record) -> Cell | None:
    """The cell of a table that a record is of; None where no table has such a row.

    Args:
        plan: that the record was made by, of General.
        settings: of the record.
    """
    subject = Subject(plan, run=True, strict=False)
    if "peer" in settings:
        known = [baseline for baseline in baselines_of(subject.app) if baseline.name == settings["peer"]]
        return baselines.baseline_cell(subject, known[0]) if known else None
    names = (settings.get("paradigm"), settings.get("rule"))
    if names[0] not in (ablation.RULE_ALONE.name, ablation.INITIALISATION_ALONE.name):
        return None
    halves = [cell for name in ablation.learned(subject) for _, _, cell in ablation.combined(subject, name)]
    of = {(cell.folder.settings["paradigm"], cell.folder.settings["rule"]): cell for cell in halves if cell.folder}
    return of.get(names)
