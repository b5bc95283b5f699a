"""The tables of `metapp evaluate`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metapp import door

if TYPE_CHECKING:
    from metapp.evaluation.rows import Table

ALL = "all"  # tables
_HERE = "metapp.evaluation.tables"
OFFERS = (
    door.Table("results", f"{_HERE}.results:RESULTS"),
    door.Table("quickft", f"{_HERE}.results:QUICKFT"),
    door.Table("image", f"{_HERE}.image:IMAGE"),
    door.Table("ablation", f"{_HERE}.ablation:ABLATION"),
    door.Table("storage", f"{_HERE}.storage:STORAGE"),
    door.Table("samples", f"{_HERE}.storage:SAMPLES"),
    door.Table("convergence", f"{_HERE}.convergence:CONVERGENCE"),
)


def table_names() -> list[str]:
    """The names of all tables."""
    return [offer.name for offer in door.offers(door.Table)]


def load_table(name: str) -> Table:
    """The table of that name, one of `table_names`."""
    (reference,) = (offer.table for offer in door.offers(door.Table) if offer.name == name)
    result: Table = door.load(reference)
    return result
