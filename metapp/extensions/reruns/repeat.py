"""Repeat rows of tables that no paradigm's command makes."""

from __future__ import annotations

from metapp.evaluation.cell import Cell
from metapp.evaluation.subject import Subject
from metapp.evaluation.tables import load_table, table_names
from metapp.runs.plan import Plan
from metapp.storage.records import Record


def cell_of(plan: Plan, settings: Record) -> Cell | None:
    """The cell of a table that a record is of; None where no table has such a row.

    Args:
        plan: that the record was made by, of General.
        settings: of the record.
    """
    subject = Subject(plan, run=True, strict=False)
    cells = (load_table(name).repeat(subject, settings) for name in table_names())
    return next((cell for cell in cells if cell), None)
